"""How much too long a time-of-flight camera may measure a range, because light is reflected twice.

In a corner the camera also receives light that another surface has sent there. Its way is longer, and the
camera measures a mean of all ways, weighted by their strengths (S. Fuchs, Multipath Interference Compensation
in Time-of-Flight Camera Images, ICPR 2010). A Lambertian place on which a share F of the hemisphere, weighted
by the cosine, shows the target itself receives at most the share F of the direct light at normal incidence,
and F / cos(theta) of it if the direct light comes at an angle theta. The way is longer by at most twice the
distance d of the other surface, and a range is half a way, so the range is too long by at most
F d / cos(theta).
"""

import numpy as np
import open3d as o3d
from scipy.stats import qmc

from rpod_schemas.arrays import FloatArray
from rpod_target import Target
from rpod_target.visibility import scene_of

DIRECTIONS = 32
"""Number of directions from each place."""
PLACES = 100_000
"""Number of places on the target; each triangle has one at least."""
MOST_PLACES = 16
"""Greatest number of places on a triangle."""
NUDGE_SHARE = 1e-4
"""Distance off the surface at which the rays start, over the target's radius."""


def reflected_m(target: Target) -> FloatArray:
    """Return F d, the greatest on each triangle, m, shape (T,): the error at normal incidence."""
    triangles_m, normals = target.triangles_m, target.normals
    count = int(np.clip(PLACES // max(len(triangles_m), 1), 1, MOST_PLACES))
    scene, nudge_m = scene_of(triangles_m), NUDGE_SHARE * target.radius_m
    inner = _barycentric(count)
    directions = _towards(normals)
    most_m = np.zeros(len(triangles_m))
    rays = np.empty((len(triangles_m), DIRECTIONS, 6), np.float32)
    rays[..., 3:] = directions
    for weights in inner:
        places_m = np.einsum("c,tcd->td", weights, triangles_m) + nudge_m * normals
        rays[..., :3] = places_m[:, None]
        distance_m = scene.cast_rays(o3d.core.Tensor.from_numpy(rays))["t_hit"].numpy()
        most_m = np.maximum(most_m, np.where(np.isfinite(distance_m), distance_m, 0.0).mean(axis=1))
    return most_m


def _barycentric(count: int) -> FloatArray:
    """Return weights of the corners for places spread evenly over a triangle, shape (count, 3)."""
    u, v = qmc.Halton(2, scramble=False).random(count + 1)[1:].T if count > 1 else np.full((2, 1), 0.5)
    root = np.sqrt(u)
    return np.column_stack((1.0 - root, root * (1.0 - v), root * v))


def _towards(normals: FloatArray) -> FloatArray:
    """Return directions about each normal, denser by the cosine (Lambert), shape (T, DIRECTIONS, 3)."""
    u, v = qmc.Halton(2, scramble=False).random(DIRECTIONS + 1)[1:].T
    radius, turn = np.sqrt(u), 2.0 * np.pi * v
    local = np.column_stack((radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1.0 - u)))
    helper = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = np.cross(normals, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    axes = np.stack((first, np.cross(normals, first), normals), axis=1)
    every: FloatArray = np.einsum("dk,tkc->tdc", local, axes)
    return every
