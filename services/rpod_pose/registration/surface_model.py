"""What the LIDAR's kernels know of the target: its faces, and its distance field."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from rpod_pose.registration.distance_field import field_arrays
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array
from rpod_target import Target

COARSE_CELLS = 3
"""Cells of the distance field that make one of the coarse field."""

Faces = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
Field = tuple[FloatArray, float, Float32Array]


@dataclass(frozen=True, eq=False)
class SurfaceModel:
    """A target's faces and field, as the kernels take them."""

    faces: Faces
    """Triangles (T, 3, 3), normals (T, 3), offsets of their planes (T,), reflectivities (T,)."""
    coarse_field: Field
    """Origin, spacing and values of the distance field, at every few nodes: it stays in a cache."""

    @classmethod
    def of(cls, target: Target) -> Self:
        """Return the model of a target.

        Raises:
            rpod_target.TargetError: the target has no distance field.
        """
        reflectivity = np.array([material.reflectivity for material in target.materials])
        offsets_m = np.einsum("ij,ij->i", target.normals, target.triangles_m[:, 0])
        triangles_m = np.ascontiguousarray(target.triangles_m)
        normals = np.ascontiguousarray(target.normals)
        origin_m, spacing_m, values = field_arrays(target)
        coarse = values[::COARSE_CELLS, ::COARSE_CELLS, ::COARSE_CELLS].copy()
        return cls(
            (triangles_m, normals, offsets_m, reflectivity[target.triangle_material]),
            (origin_m, COARSE_CELLS * spacing_m, coarse),
        )
