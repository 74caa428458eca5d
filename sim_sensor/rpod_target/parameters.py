"""Models of a target's parameter file.

Every part is defined in its own axes and placed by ``T_target_part``. A box is centred on its
origin; a prism, frustum or cylinder runs along its x axis from 0 to its length.
"""

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    field_validator,
    model_serializer,
    model_validator,
)
from scipy.spatial.transform import RigidTransform

from rpod_schemas.arrays import FloatArray, Matrix3, Vector3
from rpod_schemas.config.base import ROS_NAME, Config, Name, NonNegative, Positive, Share
from rpod_schemas.poses import Pose
from rpod_target.mesh.unusable import LARGEST_FILE_MB
from rpod_target.target import Albedo

SMALLEST_M, LARGEST_M = 0.05, 500.0
"""Longest side of a target below or above which its unit is likely wrong."""


def usual_size(longest_side_m: float) -> bool:
    """Return whether a target may have this longest side without a confirmation."""
    return SMALLEST_M <= longest_side_m <= LARGEST_M


class MaterialParameters(Config):
    """Optical properties of a surface."""

    reflectivity: Share
    """Lambertian reflectivity at the LIDAR's wavelength."""
    diffuse: Share
    """Diffuse albedo at the PMD camera's wavelength."""
    f0: Share
    """Specular reflectance at normal incidence."""
    roughness: Annotated[float, Field(gt=0, le=1)]
    """Roughness of the specular lobe."""
    crinkle_deg: Annotated[float, Field(ge=0, le=30)] = 0.0
    """Standard deviation of the tilt of a patch of foil about each axis; 0 for a smooth surface."""
    crinkle_m: Positive = 0.05
    """Size of a patch."""
    albedo: Albedo | None = None
    """Class of brightness, which is all that an estimator may know of the surface. By default foil and bare
    metal (specular reflectance of 0.5 or more) are a mirror, others dark, grey or white by
    ``reflectivity``."""

    @model_serializer(mode="wrap")
    def _without_what_is_left_out(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return the fields; without an albedo, the digest of the file stays as it was."""
        document: dict[str, Any] = handler(self)
        if self.albedo is None:
            document.pop("albedo", None)
        return document


class _PartParameters(Config):
    name: Name
    """Name of the part, unique among the parts."""
    material: str
    """Name of the part's material, for all faces without one of their own."""
    T_target_part: Pose = Field(default_factory=RigidTransform.identity)
    """Pose of the part in the target."""
    unreliable: bool = False
    """Whether the estimator ignores the part, because its shape or place is not known well: flexible foil, an
    array of unknown angle."""
    joint: Name | None = None
    """Name of the joint about which the part turns, one of ``joints``."""

    @model_serializer(mode="wrap")
    def _without_defaults(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return the fields; without those that are left out, the digest of the file stays as it was."""
        return _kept(handler(self), {"unreliable": False, "joint": None})


class BoxParameters(_PartParameters):
    """A cuboid about its own origin."""

    shape: Literal["box"]
    """Kind of the part."""
    size_m: tuple[Positive, Positive, Positive]
    """Full lengths along x, y, z."""


class PrismParameters(_PartParameters):
    """A regular prism along x; its first corner lies on the y axis, the others follow towards z."""

    shape: Literal["prism"]
    """Kind of the part."""
    sides: Annotated[int, Field(ge=3, le=256)]
    """Number of lateral faces."""
    circumradius_m: Positive
    """Distance of the corners from the axis."""
    length_m: Positive
    """Length along x, from 0."""
    top_materials: tuple[str, ...] = ()
    """Materials of the sectors of the face at x = length, repeated as needed; empty for ``material``."""
    base_materials: tuple[str, ...] = ()
    """Materials of the sectors of the face at x = 0, repeated as needed; empty for ``material``."""
    side_materials: tuple[str, ...] = ()
    """Materials of the lateral faces, from the one between the first two corners, repeated as needed."""


class FrustumParameters(_PartParameters):
    """A cone, whole or cut off, along x."""

    shape: Literal["frustum"]
    """Kind of the part."""
    base_radius_m: Positive
    """Radius at x = 0."""
    top_radius_m: NonNegative
    """Radius at x = length; 0 for a pointed cone."""
    length_m: Positive
    """Length along x, from 0."""


class CylinderParameters(_PartParameters):
    """A circular cylinder along x."""

    shape: Literal["cylinder"]
    """Kind of the part."""
    radius_m: Positive
    """Radius of the cylinder."""
    length_m: Positive
    """Length along x, from 0."""


class MeshParameters(_PartParameters):
    """A CAD or mesh file, or one object of it, scaled and then placed; its surfaces may overlap."""

    shape: Literal["mesh"]
    """Kind of the part."""
    file: str
    """Path, relative to the parameter file: STL, OBJ, PLY, glTF, GLB, or STEP with the extra ``step``."""
    object: str | None = None
    """Name of the object or group of the file that is the part; by default the whole file."""
    file_materials: dict[str, str] = Field(default_factory=dict)
    """Material of this file by the name of the material in the mesh file; others have ``material``."""
    largest_error_m: Positive | None = None
    """Largest distance between the file's surface and the triangles that replace it, where the file has
    more than 20,000; by default a thousandth of the part's longest side."""
    largest_file_mb: Positive = LARGEST_FILE_MB
    """Largest size of the file with the files that it refers to, MB. A larger one is refused before it is
    read, since reading takes several times its size in memory."""
    longest_side_m: Positive | None = None
    """Length to which the longest side of the file's bounding box is scaled."""
    metres_per_unit: Positive | None = None
    """Scale of the file's coordinates."""

    @model_validator(mode="after")
    def _one_scale(self) -> Self:
        if (self.longest_side_m is None) == (self.metres_per_unit is None):
            raise ValueError(
                "needs either longest_side_m or metres_per_unit: mesh files do not say their unit reliably"
            )
        return self

    @model_serializer(mode="wrap")
    def _without_defaults(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        added: dict[str, Any] = {
            "object": None,
            "file_materials": {},
            "largest_error_m": None,
            "largest_file_mb": LARGEST_FILE_MB,
            "unreliable": False,
            "joint": None,
        }
        return _kept(handler(self), added)


PartParameters = Annotated[
    BoxParameters | PrismParameters | FrustumParameters | CylinderParameters | MeshParameters,
    Field(discriminator="shape"),
]


def _direction(axis: FloatArray) -> FloatArray:
    if not np.linalg.norm(axis) > 0.0:
        raise ValueError(f"is {axis.tolist()}, must not be zero: give a direction, of any length")
    return axis


class FieldParameters(Config):
    """The grid of the distance field."""

    spacing_m: Positive | None = None
    """Distance of neighbouring nodes; by default a hundredth of the target's longest side."""
    margin_m: Positive | None = None
    """Extent of the grid beyond the parts; by default 0.15 of the target's longest side."""


class JointParameters(Config):
    """A joint about which parts turn, such as a solar array's. At 0 deg they are where the file has them."""

    axis: Vector3
    """Direction of the axis, of any length except zero."""
    origin_m: Vector3
    """A point on the axis."""
    limits_deg: tuple[float, float]
    """Least and greatest angle."""
    most_rate_deg_s: Positive = 1.0
    """Largest rate, deg/s."""

    @field_validator("axis")
    @classmethod
    def _is_a_direction(cls, axis: FloatArray) -> FloatArray:
        return _direction(axis)

    @field_validator("limits_deg")
    @classmethod
    def _rises(cls, limits_deg: tuple[float, float]) -> tuple[float, float]:
        least, greatest = limits_deg
        if not -360.0 <= least < greatest <= 360.0 or greatest - least > 360.0:
            raise ValueError(
                f"is [{least:g}, {greatest:g}]; it needs the least angle first, both within 360 deg and at "
                "most a turn apart"
            )
        return limits_deg


class SymmetryParameters(Config):
    """A rotation about an axis through the origin that maps the target onto itself, nearly or exactly."""

    axis: Vector3
    """Direction of the axis, of any length except zero."""
    order: Annotated[int, Field(ge=2, le=64)]
    """Order of the symmetry: the rotation is by 360 degrees over the order."""
    exact: bool = False
    """Whether surfaces and materials are the same after it: no measurement distinguishes the two poses. An
    exact symmetry of order 24 or more counts as continuous."""
    continuous: bool = False
    """Whether the same holds for every rotation about the axis, as for a body of revolution: the angle about
    the axis is free, and its estimate has a standard deviation of 104 deg. Where that is near, not exact, the
    order gives the rotations that are tried one by one."""

    @model_serializer(mode="wrap")
    def _without_defaults(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return the fields; without that of later versions, the digest of the file stays as it was."""
        return _kept(handler(self), {"continuous": False})

    @field_validator("axis")
    @classmethod
    def _is_a_unit_vector(cls, axis: FloatArray) -> FloatArray:
        return _direction(axis) / float(np.linalg.norm(axis))


FrameName = Annotated[str, Field(pattern=ROS_NAME)]
"""Name of a frame: part of a topic of ROS 2, which has no hyphens."""


class CameraErrorsParameters(Config):
    """How far a target's edges in a camera's images err, over what a frame states of itself."""

    factor: Annotated[float, Field(ge=1, le=16)]
    """Variance of the errors of edges over the stated one."""
    interval: tuple[Positive, Positive] | None = None
    """Its 90 % interval."""
    frames: Annotated[int, Field(ge=1)] | None = None
    """Number of emulated frames that it follows from."""
    seed: int | None = None
    """Seed of these frames."""


class TargetParameters(Config):
    """A target's parameter file."""

    name: Name
    """Name of the target in logs and reports."""
    centre_of_mass_m: Vector3 | None = None
    """Centre of mass, target axes; by default that of the parts."""
    inertia_kg_m2: Matrix3 | None = None
    """Inertia about the centre of mass, target axes; by default that of the parts, by ``mass_kg`` or
    ``density_kg_m3``."""
    mass_kg: Positive | None = None
    """Mass, spread evenly over the parts, for the centre of mass and the inertia that are not given."""
    density_kg_m3: Positive | None = None
    """Density of the parts' volume, instead of ``mass_kg``."""
    mass_spread: Literal["volume", "surface"] = "volume"
    """Whether the mass is in the volume of the closed surfaces or on the area of all surfaces, as a skin."""
    confirmed_size: bool = False
    """Whether a longest side below 0.05 m or above 500 m is meant."""
    materials: Annotated[dict[Name, MaterialParameters], Field(min_length=1)]
    """Materials by name."""
    parts: Annotated[tuple[PartParameters, ...], Field(min_length=1)]
    """Parts of the target, which may touch and overlap."""
    distance_field: FieldParameters = FieldParameters()
    """The grid of the signed distance field."""
    model_points: Annotated[int, Field(ge=10, le=100_000)] = 1200
    """Number of points sampled evenly over the visible surface."""
    edge_crease_deg: Annotated[float, Field(gt=0, lt=180)] = 30.0
    """Least angle between two faces of a part at a segment of the wireframe."""
    symmetries: tuple[SymmetryParameters, ...] = ()
    """Rotations after which the target is the same or nearly so; acquisition tries them too."""

    frames: dict[FrameName, Pose] = Field(default_factory=dict)
    """Frames of the target, such as the launch adapter or a grapple fixture: T_target_frame by name. The
    estimator publishes their poses."""
    tolerance_m: NonNegative = 0.0
    """How far places of the surface may be off from the real target, one standard deviation of each
    coordinate. Places of one part within 0.4 of the longest side count as having the same offset. The
    covariances contain it."""
    scale_tolerance: Share = 0.0
    """Share by which the real target may be larger or smaller as a whole, one standard deviation."""
    camera_errors: CameraErrorsParameters | None = None
    """How far its edges in a camera's images err, as ``rpod target errors`` measured it."""
    joints: dict[FrameName, JointParameters] = Field(default_factory=dict)
    """Joints by name, each named by the parts that turn about it. The estimator finds their angles."""

    @field_validator("inertia_kg_m2")
    @classmethod
    def _inertia_is_physical(cls, inertia: FloatArray | None) -> FloatArray | None:
        if inertia is None:
            return None
        if not np.allclose(inertia, inertia.T):
            raise ValueError("is not symmetric; correct the elements off the diagonal")
        moments = np.linalg.eigvalsh(inertia)
        if moments[0] <= 0.0:
            raise ValueError(
                f"is not positive definite: least principal moment {moments[0]:.4g} kg m2; correct it"
            )
        if moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-9):
            raise ValueError(
                f"breaks the triangle inequality: one principal moment, {moments[2]:.4g} kg m2, exceeds the "
                f"sum of the others, {moments[0] + moments[1]:.4g} kg m2; correct them"
            )
        return inertia

    @field_validator("parts")
    @classmethod
    def _part_names_differ(cls, parts: tuple[PartParameters, ...]) -> tuple[PartParameters, ...]:
        names = [part.name for part in parts]
        repeated = [name for index, name in enumerate(names) if name in names[:index]]
        if repeated:
            raise ValueError(f"two parts are named {repeated[0]!r}; give each its own name")
        return parts

    @model_serializer(mode="wrap")
    def _without_defaults(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return the fields; without those that are left out, the digest of the file stays as it was."""
        added: dict[str, Any] = {
            "centre_of_mass_m": None,
            "inertia_kg_m2": None,
            "mass_kg": None,
            "density_kg_m3": None,
            "mass_spread": "volume",
            "confirmed_size": False,
            "frames": {},
            "tolerance_m": 0.0,
            "scale_tolerance": 0.0,
            "camera_errors": None,
            "joints": {},
        }
        return _kept(handler(self), added)

    @model_validator(mode="after")
    def _joints_have_parts(self) -> Self:
        used = {part.joint for part in self.parts} - {None}
        if unknown := sorted(str(name) for name in used - set(self.joints)):
            known = ", ".join(self.joints) or "none"
            raise ValueError(f"parts name unknown joints: {', '.join(unknown)}; joints has {known}")
        if unused := sorted(set(self.joints) - used):
            raise ValueError(f"no part names these joints: {', '.join(unused)}; remove them, or name them")
        if all(part.joint for part in self.parts):
            raise ValueError("every part names a joint; at least one part without a joint is needed")
        return self


def _kept(document: dict[str, Any], defaults: dict[str, Any]) -> dict[str, Any]:
    """Return a document without the fields that have these values."""
    return {
        name: value for name, value in document.items() if name not in defaults or value != defaults[name]
    }
