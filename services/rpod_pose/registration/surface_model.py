"""Model of the target for the LIDAR's kernels: its faces and its distance field."""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from rpod_pose.registration.brightness import albedos
from rpod_pose.registration.distance_field import FieldArrays, checked, field_arrays
from rpod_schemas.arrays import FloatArray
from rpod_target import Target

COARSE_CELLS = 3
"""Cells of the distance field per cell of the coarse field, along each axis."""


class Faces(NamedTuple):
    """The target's triangles, as the kernels take them."""

    triangles_m: FloatArray
    """Corners, target axes, shape (T, 3, 3)."""
    normals: FloatArray
    """Outward unit normals, target axes, shape (T, 3)."""
    offsets_m: FloatArray
    """Offsets of the triangles' planes, n . v0, shape (T,), m."""
    albedo: FloatArray
    """Median albedo of the class of each triangle's material, shape (T,)."""


@dataclass(frozen=True, eq=False)
class SurfaceModel:
    """A target's faces and field, as the kernels take them."""

    faces: Faces
    coarse_field: FieldArrays
    """The distance field at every third node: small enough for a processor's cache."""

    @classmethod
    def of(cls, target: Target) -> Self:
        """Return the model of a target.

        Raises:
            rpod_target.TargetError: the target has no distance field.
        """
        offsets_m = np.einsum("ij,ij->i", target.normals, target.triangles_m[:, 0])
        triangles_m = np.ascontiguousarray(target.triangles_m)
        normals = np.ascontiguousarray(target.normals)
        origin_m, spacing_m, values = field_arrays(target)
        coarse = values[::COARSE_CELLS, ::COARSE_CELLS, ::COARSE_CELLS].copy()
        return cls(
            Faces(triangles_m, normals, offsets_m, albedos(target)),
            checked(target, FieldArrays(origin_m, COARSE_CELLS * spacing_m, coarse)),
        )
