"""Upper limit of the error of a range in a time-of-flight camera when light is reflected twice on the target.

In a corner the camera also receives light that another surface has reflected there. The path of this light is
longer, and the camera measures a mean of all paths, weighted by their strengths (S. Fuchs, Multipath
Interference Compensation in Time-of-Flight Camera Images, ICPR 2010). From a place on the target, a share F
of the hemisphere, weighted by the cosine, may show the target itself. A Lambertian place then receives at
most the share F of the direct light at normal incidence, and F / cos(theta) of it if the direct light comes
at an angle theta. The path is longer by at most twice the distance d of the other surface, and a range is
half a path. So the range is too long by at most F d / cos(theta).
"""

import numpy as np

from rpod_schemas.arrays import FloatArray
from rpod_target import Target
from rpod_target.tables import kept_of

DIRECTIONS = 32
"""Number of directions from each place. Numerics: a budget of computation."""
PLACES = 100_000
"""Number of places on the target; each triangle has at least one. Numerics: a budget of computation."""
MOST_PLACES = 16
"""Largest number of places on a triangle. Numerics: a budget for targets of few triangles."""
MOST_RAYS = 2_000_000
"""Number of rays that are cast at a time. Numerics: memory."""
NUDGE_SHARE = 1e-4
"""Distance off the surface at which the rays start, over the target's radius. Numerics: far above the
rounding, far below any detail."""


def reflected_m(target: Target) -> FloatArray:
    """Return the largest F d on each triangle, m, shape (T,): the limit of the error at normal incidence.

    The result is kept in the cache of targets, since the import of Open3D alone takes 0.7 s.
    """
    inputs = target.triangles_m, target.normals, target.radius_m, DIRECTIONS, PLACES, MOST_PLACES, NUDGE_SHARE
    return kept_of(target, "reflected", 1, inputs, lambda: {"error_m": _computed_m(target)})["error_m"]


def _computed_m(target: Target) -> FloatArray:
    import open3d as o3d  # noqa: PLC0415 - imported only where the cache has no table

    from rpod_target.visibility import inner_points, scene_of, sphere  # noqa: PLC0415 - as above

    triangles_m, normals = target.triangles_m, target.normals
    count = int(np.clip(PLACES // max(len(triangles_m), 1), 1, MOST_PLACES))
    scene, nudge_m = scene_of(triangles_m), NUDGE_SHARE * target.radius_m
    directions, inner, most_m = sphere(DIRECTIONS), inner_points(count), np.zeros(len(triangles_m))
    size = max(1, MOST_RAYS // (DIRECTIONS * count))
    for start in range(0, len(triangles_m), size):
        some = slice(start, start + size)
        places_m = np.einsum("kc,tcd->tkd", inner, triangles_m[some]) + nudge_m * normals[some, None]
        cosine = normals[some] @ directions.T
        rays = np.empty((*places_m.shape[:2], DIRECTIONS, 6), np.float32)
        rays[..., :3] = places_m[:, :, None]
        rays[..., 3:] = (np.sign(cosine)[..., None] * directions)[:, None]  # all before the surface
        distance_m = scene.cast_rays(o3d.core.Tensor.from_numpy(rays))["t_hit"].numpy()
        weights = np.abs(cosine) / np.abs(cosine).sum(axis=1, keepdims=True)
        met_m = np.where(np.isfinite(distance_m), distance_m, 0.0)
        most_m[some] = np.einsum("tkd,td->tk", met_m, weights).max(axis=1)
    return most_m
