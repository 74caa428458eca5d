"""The target in the form that a search renders: few triangles, with the brightness of their materials."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_pose.registration.brightness import albedos, spreads
from rpod_schemas.arrays import FloatArray
from rpod_target import Target
from rpod_target.tables import Tables, kept_of

SIMPLER = 500, 1_000, 1_500, 2_500, 4_000, 10_000
"""Numbers of triangles to which a mesh may be simplified; the least sufficient one is used. Numerics:
hundreds of poses are rendered in a search."""
SIMPLER_SHARE = 0.005
"""Largest error of the simplified mesh, over the longest side. Numerics: a fifth of a coarse pixel, of which
about 40 are along the target."""
LEAST_AREA = 1e-30
"""Least area in a division, m2. Numerics: it avoids a division by zero."""


def _simpler(target: Target) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return a target's simplified triangles, and for each the index of an original triangle."""
    every = target.triangles_m
    if len(every) <= SIMPLER[0]:
        return every, np.arange(len(every))

    def make() -> Tables:
        from rpod_target.mesh.simplification import simplified  # noqa: PLC0415 - Open3D takes 0.7 s of a start

        size_m = float(np.ptp(every.reshape(-1, 3), axis=0).max())
        triangles_m, which, _ = simplified(every, largest_error=SIMPLER_SHARE * size_m, steps=SIMPLER)
        return {"triangles_m": triangles_m, "which": which}

    found = kept_of(target, "simpler", 1, (every, SIMPLER, SIMPLER_SHARE), make)
    return found["triangles_m"], found["which"]


class Surface(NamedTuple):
    """The simplified target with its expected brightness."""

    triangles_m: FloatArray
    """Corners, target axes, shape (T, 3, 3)."""
    normals: FloatArray
    """Outward unit normals, target axes, shape (T, 3)."""
    albedo: FloatArray
    """Median albedo of each triangle's class, shape (T,)."""
    sigma_log: FloatArray
    """Standard deviation of the albedo's logarithm, shape (T,)."""
    radius_m: float
    """Distance of the target's farthest point from its origin."""

    @classmethod
    def of(cls, target: Target) -> "Surface":
        """Return the surface of a target."""
        triangles_m, which = _simpler(target)
        normals = np.cross(triangles_m[:, 1] - triangles_m[:, 0], triangles_m[:, 2] - triangles_m[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), LEAST_AREA)
        return cls(
            np.ascontiguousarray(triangles_m),
            normals,
            albedos(target)[which],
            spreads(target)[which],
            target.radius_m,
        )
