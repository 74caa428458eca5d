"""A component of a satellite, and how components are placed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.random import Generator
from scipy.spatial.transform import Rotation

from rpod_schemas.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Component:
    """Closed surfaces of one material, which become a part of the target."""

    name: str
    mesh: trimesh.Trimesh
    """Surfaces in target axes, before the satellite is scaled to its size."""
    material: str

    @property
    def area(self) -> float:
        """Area of the surfaces."""
        return float(self.mesh.area)


def pose(translation: Sequence[float] | FloatArray, rotation: Rotation | None = None) -> FloatArray:
    """Return the homogeneous matrix of a rotation and a translation, shape (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, 3] = translation
    if rotation is not None:
        matrix[:3, :3] = rotation.as_matrix()
    return matrix


def placed(mesh: trimesh.Trimesh, matrix: FloatArray) -> trimesh.Trimesh:
    """Return a mesh moved by a homogeneous matrix."""
    moved = mesh.copy()
    moved.apply_transform(matrix)
    return moved


def joined(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return meshes as one; they may overlap."""
    together = trimesh.util.concatenate(list(meshes))
    if not isinstance(together, trimesh.Trimesh):
        raise TypeError(f"{len(meshes)} meshes gave {type(together).__name__}, not one mesh")
    return together


def along_x(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return a mesh whose z axis is turned onto the x axis, y onto z."""
    matrix = np.eye(4)
    matrix[:3, :3] = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    return placed(mesh, matrix)


def facing(point: FloatArray, normal: FloatArray, roll_rad: float = 0.0) -> FloatArray:
    """Return the pose of something that stands at a point with its z axis along a normal, shape (4, 4)."""
    turn = Rotation.align_vectors([normal], [[0.0, 0.0, 1.0]])[0] * Rotation.from_euler("z", roll_rad)
    return pose(point, turn)


def places(mesh: trimesh.Trimesh, count: int, generator: Generator) -> tuple[FloatArray, FloatArray]:
    """Return random places on a surface, and the outward normals there, shape (N, 3) each."""
    sampled = trimesh.sample.sample_surface(mesh, count, seed=generator)
    return np.asarray(sampled[0], float), np.asarray(mesh.face_normals[np.asarray(sampled[1])], float)


def bar(
    begin: Sequence[float] | FloatArray, end: Sequence[float] | FloatArray, radius: float, sections: int
) -> trimesh.Trimesh:
    """Return a round bar between two points."""
    found: trimesh.Trimesh = trimesh.creation.cylinder(
        radius=radius, segment=np.array([begin, end]), sections=sections
    )
    return found
