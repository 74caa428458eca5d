"""The target's surfaces in an exposure. The planes of a triangle are computed only if a ray hits it.

A mesh may have a hundred thousand triangles, and an image shows only a part of them. So a triangle's planes
are computed for the first pixel that hits it, and stored for the other pixels of the frame.

Multi-layer insulation (MLI) is a crinkled mirror. Its surface is divided into patches with different tilts,
which are fixed to the target and move with it. The patches are the cells of a cubic lattice. The lattice is
rotated from the target axes, so that no face of the target lies along a boundary of its cells.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array
from rpod_sim_sensor.surroundings import Scenery

_LATTICE = Rotation.from_rotvec((0.7, -0.4, 0.55)).as_matrix()
"""Rotation from target axes into the lattice's."""


class Surfaces(NamedTuple):
    """The target's triangles in one exposure."""

    normals: FloatArray
    """Unit normals, target axes, shape (T, 3)."""
    offsets_m: FloatArray
    """Offsets n . v0 of the planes, target axes, shape (T,)."""
    material: NDArray[np.int32]
    """Index of each triangle's row in ``materials``, shape (T,)."""
    materials: FloatArray
    """Diffuse albedo, specular reflectance, squared width of the lobe, patches per metre, and tilt of a patch
    in rad, shape (M, 5)."""
    rotations: FloatArray
    """R_optical_target in the middle of the exposure, then in each sub-exposure; then as many identities, for
    things that stand still; shape (2, K + 1, 3, 3)."""
    positions_m: FloatArray
    """t_optical_target at the same times, then zeros, shape (2, K + 1, 3)."""
    R_lattice_optical: FloatArray
    """Rotation from optical axes into the lattice's, shape (3, 3)."""
    t_lattice_optical: FloatArray
    """Origin of the optical axes in the lattice's, shape (3,)."""
    moving: int
    """Number of the triangles that move with the target, the first ones; the others, in optical axes, stand
    still."""
    frame: int
    """Number of this exposure among the scene's."""
    placed: NDArray[np.int64]
    """Last exposure for which a triangle's planes were computed, shape (T,)."""
    planes: Float32Array
    """n / (n . v0), optical axes, shape (T, K + 1, 3): a ray d meets the plane at 1 / (plane . d)."""
    far_normals: Float32Array
    """Unit normals away from the camera, in the middle of the exposure, optical axes, shape (T, 3)."""


class Scene:
    """The triangles and materials that the camera sees, to be placed by pose."""

    def __init__(self, seen: Scenery, sub_exposures: int) -> None:
        target = seen.moving
        self._moving = len(target.triangles_m)
        self._normals = np.concatenate((target.normals, seen.still_normals))
        self._material = np.concatenate((target.triangle_material, seen.still_material))
        self._materials = np.array(
            [
                (m.diffuse, m.f0, m.roughness**4, 1.0 / m.crinkle_m, np.deg2rad(m.crinkle_deg))
                for m in target.materials
            ]
        )
        corners_m = np.concatenate((target.triangles_m[:, 0], seen.still_m[:, 0]))
        self._offsets_m = np.einsum("ti,ti->t", self._normals, corners_m)
        count = len(self._normals)
        self._placed = np.zeros(count, np.int64)
        self._planes = np.empty((count, sub_exposures + 1, 3), np.float32)
        self._far_normals = np.empty((count, 3), np.float32)
        self._frame = 0

    def placed(self, T_middle: RigidTransform, poses: Sequence[RigidTransform]) -> Surfaces:
        """Return the surfaces at T_optical_target in the middle of the exposure and in each sub-exposure.

        They share the scene's buffers and are valid until the next call.
        """
        self._frame += 1
        matrices = np.stack([pose.as_matrix() for pose in (T_middle, *poses)])
        matrices = np.stack((matrices, np.broadcast_to(np.eye(4), matrices.shape)))
        rotations, positions_m = matrices[..., :3, :3].copy(), matrices[..., :3, 3].copy()
        R_lattice_optical = _LATTICE @ rotations[0, 0].T
        return Surfaces(
            normals=self._normals,
            offsets_m=self._offsets_m,
            material=self._material,
            materials=self._materials,
            rotations=rotations,
            positions_m=positions_m,
            R_lattice_optical=R_lattice_optical,
            t_lattice_optical=-R_lattice_optical @ positions_m[0, 0],
            moving=self._moving,
            frame=self._frame,
            placed=self._placed,
            planes=self._planes,
            far_normals=self._far_normals,
        )


@inner_kernel
def place(index: int, surfaces: Surfaces) -> None:
    """Compute the planes of one triangle, an index below T, at the poses of the exposure."""
    body = 0 if index < surfaces.moving else 1
    normal, R, t = surfaces.normals[index], surfaces.rotations[body], surfaces.positions_m[body]
    plane = surfaces.planes[index]
    for k in range(R.shape[0]):
        offset_m = surfaces.offsets_m[index]
        for i in range(3):
            n_i = R[k, i, 0] * normal[0] + R[k, i, 1] * normal[1] + R[k, i, 2] * normal[2]
            offset_m += n_i * t[k, i]
            plane[k, i] = n_i
        for i in range(3):
            if k == 0:
                surfaces.far_normals[index, i] = np.copysign(1.0, offset_m) * plane[k, i]
            plane[k, i] = plane[k, i] / offset_m if offset_m != 0.0 else 0.0  # seen edge-on: no ray hits it
    surfaces.placed[index] = surfaces.frame


@kernel
def crinkled(  # noqa: PLR0917
    x: float, y: float, z: float, R: FloatArray, t: FloatArray, per_m: float, tilt_rad: float
) -> tuple[float, float, float]:
    """Return the vector that a patch adds to its normal, optical axes, before the sum is normalised.

    Args:
        x: first coordinate of the point, optical axes, m.
        y: second coordinate.
        z: third coordinate.
        R: ``Surfaces.R_lattice_optical``.
        t: ``Surfaces.t_lattice_optical``.
        per_m: cells of the lattice per metre.
        tilt_rad: standard deviation of the tilt about each axis.
    """
    i = int(np.floor((R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0]) * per_m))
    j = int(np.floor((R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1]) * per_m))
    k = int(np.floor((R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2]) * per_m))
    mixed = i * 73856093 ^ j * 19349663 ^ k * 83492791
    for _ in range(2):  # after Wellons' hash prospector: each bit of the cell flips half of the bits
        mixed = ((mixed >> 32 ^ mixed) & 0xFFFFFFFF) * 0x45D9F3B
    scale = tilt_rad * np.sqrt(3.0) / 1024.0  # uniform over +-1 has a variance of 1/3
    a = scale * ((mixed & 0x7FF) - 1023.5)
    b = scale * ((mixed >> 11 & 0x7FF) - 1023.5)
    c = scale * ((mixed >> 22 & 0x7FF) - 1023.5)
    return (
        R[0, 0] * a + R[1, 0] * b + R[2, 0] * c,
        R[0, 1] * a + R[1, 1] * b + R[2, 1] * c,
        R[0, 2] * a + R[1, 2] * b + R[2, 2] * c,
    )
