"""The target for sensors and estimators. All coordinates are in target axes, metres."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_schemas.arrays import FloatArray
from rpod_target.equivalence import Equivalence, Symmetry
from rpod_target.errors import TargetError

Int32Array = NDArray[np.int32]

Albedo = Literal["dark", "grey", "white", "mirror"]
"""Class of brightness, visible without instruments: dark for solar cells and black paint, grey for painted
panels, white for white paint, mirror for foil and bare metal."""

_MIRROR_F0, _DARK, _GREY = 0.5, 0.2, 0.5
"""Least specular reflectance of a mirror; reflectivities below which a surface is dark or grey."""


@dataclass(frozen=True)
class Material:
    """Optical properties of a surface."""

    name: str
    reflectivity: float
    """Lambertian reflectivity at the LIDAR's wavelength, 0 to 1."""
    diffuse: float
    """Diffuse albedo at the PMD camera's wavelength, 0 to 1."""
    f0: float
    """Specular reflectance at normal incidence (Schlick), 0 to 1."""
    roughness: float
    """Roughness of the specular lobe, 0 to 1."""
    crinkle_deg: float = 0.0
    """Standard deviation of the tilt of a patch of the surface about each axis; 0 for a smooth surface."""
    crinkle_m: float = 0.05
    """Size of a patch."""
    albedo: Albedo | None = None
    """Class of brightness in the target file, if it is given."""

    @property
    def looks(self) -> Albedo:
        """Class of brightness, which is all that an estimator may know of a material."""
        if self.albedo is not None:
            return self.albedo
        if self.crinkle_deg > 0.0 or self.f0 >= _MIRROR_F0:
            return "mirror"
        if self.reflectivity < _GREY:
            return "dark" if self.reflectivity < _DARK else "grey"
        return "white"


@dataclass(frozen=True, eq=False)
class DistanceField:
    """Signed distance on a regular grid, negative inside: the minimum over the parts."""

    origin_m: FloatArray
    """Position of node (0, 0, 0), shape (3,)."""
    spacing_m: float
    values: NDArray[np.float32]
    """Distance at ``origin_m + spacing_m * (i, j, k)``, shape (nx, ny, nz), m."""


@dataclass(frozen=True, eq=False)
class Joint:
    """Parts of a target that turn together about an axis."""

    name: str
    axis: FloatArray
    """Unit vector along the axis, target axes, shape (3,)."""
    origin_m: FloatArray
    """A point on the axis, target axes, shape (3,)."""
    limits_rad: tuple[float, float]
    """Least and greatest angle; at 0 the parts are where the target's file places them."""
    rate_rad_s: float
    """Largest rate."""
    moving: "Target"
    """The parts alone, at the angle 0."""

    def turned(self, angle_rad: float) -> RigidTransform:
        """Return the motion of the parts from the angle 0 to an angle, target axes."""
        turn = RigidTransform.from_rotation(Rotation.from_rotvec(angle_rad * self.axis))
        there = RigidTransform.from_translation(self.origin_m)
        return there * turn * there.inv()

    @property
    def lever_m(self) -> float:
        """Distance of the farthest corner of the parts from the axis."""
        arms_m = np.cross(self.moving.triangles_m.reshape(-1, 3) - self.origin_m, self.axis)
        return float(np.linalg.norm(arms_m, axis=1).max())


@dataclass(frozen=True, eq=False)
class Target:
    """A target, ready for use; equal digests mean equal targets."""

    name: str
    source: str
    """Parameter file from which the target was read."""
    digest: str
    """SHA-256 of the resolved parameters, the mesh files' bytes and the builder's version."""
    triangles_m: FloatArray
    """Corners of the triangles, shape (T, 3, 3), counter-clockwise seen from outside."""
    normals: FloatArray
    """Outward unit normals of the triangles, shape (T, 3)."""
    triangle_material: Int32Array
    """Index into ``materials``, shape (T,)."""
    triangle_part: Int32Array
    """Index into ``parts``, shape (T,)."""
    materials: tuple[Material, ...]
    parts: tuple[str, ...]
    """Names of the parts; the second side of a surface that is seen from both sides is a part of its own,
    whose name ends with ``-back``."""
    edges_m: FloatArray
    """Wireframe segments: creases and open boundaries of each part, shape (E, 2, 3)."""
    edge_normals: FloatArray
    """Normals of the two faces beside each segment, shape (E, 2, 3); at an open boundary n and -n."""
    model_points_m: FloatArray
    """Even samples of the visible surface, shape (N, 3)."""
    model_normals: FloatArray
    """Outward unit normals at the model points, shape (N, 3)."""
    field: DistanceField | None
    """Distance field; None in a target put together without one."""
    repairs: tuple[str, ...]
    """Repairs and approximations of the mesh files, one sentence each."""
    centre_of_mass_m: FloatArray
    """Centre of mass, shape (3,)."""
    inertia_kg_m2: FloatArray
    """Inertia about the centre of mass, target axes, shape (3, 3)."""
    radius_m: float
    """Radius of the bounding sphere about the origin."""
    symmetries: tuple[Symmetry, ...]
    frames: Mapping[str, RigidTransform] = dataclass_field(default_factory=dict)
    """Poses T_target_frame of the frames that its file names, by name."""

    reliable: "Target | None" = None
    """The target without the parts that its file calls unreliable; None if there are none."""
    tolerance_m: float = 0.0
    """How far places of its surface may be off, one standard deviation of each coordinate; near places of one
    part have the same offset."""
    scale_tolerance: float = 0.0
    """Share by which it may be too large or too small as a whole, one standard deviation."""
    camera_errors: float | None = None
    """Variance of the errors of its edges in a camera's images over what a frame states; None if it was not
    measured."""
    joints: tuple[Joint, ...] = ()
    """Joints that its file declares; ``posed`` returns the target at given angles of them."""
    fixed: "Target | None" = None
    """The target without the parts of its joints; None if there are none."""
    content: str = ""
    """SHA-256 of the arrays that were built or read from the cache; ``digest`` states what they should be."""

    def require_field(self) -> DistanceField:
        """Return the distance field.

        Raises:
            TargetError: the target was put together without a field; one from a file always has it.
        """
        if self.field is None:
            raise TargetError(self.source, "distance_field", "is missing: load the target from its file")
        return self.field

    @property
    def content_digest(self) -> str:
        """Digest of the arrays of this target and of all targets that it holds."""
        held = (self.reliable, self.fixed, *(joint.moving for joint in self.joints))
        inner = [target.content_digest for target in held if target is not None]
        return (
            hashlib.sha256(" ".join([self.content, *inner]).encode()).hexdigest() if inner else self.content
        )

    @cached_property
    def equivalence(self) -> Equivalence:
        """Attitudes that no measurement distinguishes."""
        return Equivalence.of(self.symmetries)

    def turns(self, *, exact: bool = False) -> list[RigidTransform]:
        """Return the rotations of all declared symmetries, without the identity.

        The exact ones alone are all turns that the declared ones generate, modulo those about a free axis.
        """
        if exact:
            every = [Rotation.from_matrix(turn) for turn in self.equivalence.turns[1:]]
        else:
            every = [
                Rotation.from_rotvec(2.0 * np.pi * k / symmetry.order * np.array(symmetry.axis))
                for symmetry in self.symmetries
                for k in range(1, symmetry.order)
            ]
        return [RigidTransform.from_rotation(turn) for turn in every]
