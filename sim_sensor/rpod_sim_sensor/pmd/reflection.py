"""Reflection of light by a surface: a diffuse part and a specular lobe.

The lobe is the microfacet model with the GGX distribution (Walter et al., EGSR 2007), the height-correlated
Smith masking (Heitz, JCGT 3(2), 2014) and Schlick's Fresnel term. The distribution's width alpha is the
square of a material's roughness (Burley, SIGGRAPH course, 2012). A source that is not a point widens the
lobe: alpha^2 grows by the square of half its angular radius, since the half vector turns by half (after
Karis, SIGGRAPH course, 2013).
"""

import math

from rpod_geometry.kernels import kernel


@kernel
def reflected_share(  # noqa: PLR0917
    n_l: float, n_v: float, l_v: float, diffuse: float, f0: float, alpha2: float
) -> float:
    """Return BRDF times n.l, 1/sr: radiance over the irradiance of a surface that faces the light.

    Args:
        n_l: cosine between the normal and the light, > 0.
        n_v: cosine between the normal and the viewer, > 0.
        l_v: cosine between the light and the viewer; 1 for the camera's own lamp.
        diffuse: albedo of the Lambertian part.
        f0: specular reflectance at normal incidence.
        alpha2: squared width of the lobe, > 0.
    """
    half2 = 0.5 * (1.0 + l_v)  # (v.h)^2
    n_h2 = min((n_l + n_v) ** 2 / (4.0 * half2), 1.0)
    spread = 1.0 - n_h2 * (1.0 - alpha2)
    density = alpha2 / (math.pi * spread * spread)
    masked_v = math.sqrt(alpha2 + n_v * n_v * (1.0 - alpha2))
    masked_l = math.sqrt(alpha2 + n_l * n_l * (1.0 - alpha2))
    visibility = 0.5 / (n_l * masked_v + n_v * masked_l)  # G / (4 n.l n.v)
    fresnel = f0 + (1.0 - f0) * (1.0 - math.sqrt(half2)) ** 5
    return n_l * (diffuse / math.pi + density * visibility * fresnel)
