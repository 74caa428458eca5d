"""The parameter file of a target, as models.

Every part stands in its own axes and is placed by ``T_target_part``. A box is centred on its
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
from rpod_schemas.config.base import Config, Name, NonNegative, Positive, Share
from rpod_schemas.poses import Pose
from rpod_target.target import Albedo


class MaterialParameters(Config):
    """How a surface answers to light."""

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
    """How bright the surface looks: all that an estimator may know of it. Left out, foil and bare metal (a
    specular reflectance of a half and more) are a mirror, others dark, grey or white by ``reflectivity``."""

    @model_serializer(mode="wrap")
    def _without_what_is_left_out(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return the fields; a file that says nothing of the albedo keeps its digest."""
        document: dict[str, Any] = handler(self)
        if self.albedo is None:
            document.pop("albedo", None)
        return document


class _PartParameters(Config):
    name: Name
    """Unique among the parts."""
    material: str
    """Name of a material; of the whole part where nothing more special is said."""
    T_target_part: Pose = Field(default_factory=RigidTransform.identity)
    """Where the part stands."""


class BoxParameters(_PartParameters):
    """A cuboid about its own origin."""

    shape: Literal["box"]
    """Which kind of part this is."""
    size_m: tuple[Positive, Positive, Positive]
    """Full lengths along x, y, z."""


class PrismParameters(_PartParameters):
    """A regular prism along x; its first corner lies on the y axis, the others follow towards z."""

    shape: Literal["prism"]
    """Which kind of part this is."""
    sides: Annotated[int, Field(ge=3, le=256)]
    """Number of lateral faces."""
    circumradius_m: Positive
    """Distance of the corners from the axis."""
    length_m: Positive
    """Along x, from 0."""
    top_materials: tuple[str, ...] = ()
    """Of the sectors of the face at x = length, repeated as often as needed; empty for ``material``."""
    base_materials: tuple[str, ...] = ()
    """Of the sectors of the face at x = 0, likewise."""
    side_materials: tuple[str, ...] = ()
    """Of the lateral faces, likewise; the first lies between the first two corners."""


class FrustumParameters(_PartParameters):
    """A cone, whole or cut off, along x."""

    shape: Literal["frustum"]
    """Which kind of part this is."""
    base_radius_m: Positive
    """At x = 0."""
    top_radius_m: NonNegative
    """At x = length; 0 for a pointed cone."""
    length_m: Positive
    """Along x, from 0."""


class CylinderParameters(_PartParameters):
    """A circular cylinder along x."""

    shape: Literal["cylinder"]
    """Which kind of part this is."""
    radius_m: Positive
    """Of both faces."""
    length_m: Positive
    """Along x, from 0."""


class MeshParameters(_PartParameters):
    """An STL file, scaled and then placed; its separate closed surfaces may overlap."""

    shape: Literal["mesh"]
    """Which kind of part this is."""
    file: str
    """Path, relative to the parameter file."""
    longest_side_m: Positive | None = None
    """Scale so that the longest side of the file's bounding box has this length."""
    metres_per_unit: Positive | None = None
    """Scale by this factor."""

    @model_validator(mode="after")
    def _one_scale(self) -> Self:
        if (self.longest_side_m is None) == (self.metres_per_unit is None):
            raise ValueError("needs either longest_side_m or metres_per_unit")
        return self


PartParameters = Annotated[
    BoxParameters | PrismParameters | FrustumParameters | CylinderParameters | MeshParameters,
    Field(discriminator="shape"),
]


class FieldParameters(Config):
    """The grid of the distance field."""

    spacing_m: Positive
    """Distance of neighbouring nodes."""
    margin_m: Positive
    """How far the grid reaches beyond the parts."""


class SymmetryParameters(Config):
    """A turn about an axis through the origin that maps the target onto itself, nearly or exactly."""

    axis: Vector3
    """Direction, of any length but zero."""
    order: Annotated[int, Field(ge=2, le=64)]
    """The turn is by 360 degrees over the order."""
    exact: bool = False
    """Surfaces and materials are the same after the turn: no measurement tells the two poses apart."""

    @field_validator("axis")
    @classmethod
    def _has_direction(cls, axis: FloatArray) -> FloatArray:
        length = float(np.linalg.norm(axis))
        if length == 0.0:
            raise ValueError("needs a direction, not the zero vector")
        return axis / length


class TargetParameters(Config):
    """A target's parameter file."""

    name: Name
    """What the target is called in logs and reports."""
    centre_of_mass_m: Vector3
    """In target axes."""
    inertia_kg_m2: Matrix3
    """About the centre of mass, in target axes."""
    materials: Annotated[dict[Name, MaterialParameters], Field(min_length=1)]
    """By name."""
    parts: Annotated[tuple[PartParameters, ...], Field(min_length=1)]
    """What the target is made of; parts may touch and overlap."""
    distance_field: FieldParameters
    """The grid of the signed distance field."""
    model_points: Annotated[int, Field(ge=10, le=100_000)] = 1200
    """Number of points sampled evenly over the visible surface."""
    edge_crease_deg: Annotated[float, Field(gt=0, lt=180)] = 30.0
    """Faces of a part that meet at more than this angle make a segment of the wireframe."""
    symmetries: tuple[SymmetryParameters, ...] = ()
    """Turns after which the target looks the same or nearly so: acquisition tries them as siblings."""

    @field_validator("inertia_kg_m2")
    @classmethod
    def _inertia_is_physical(cls, inertia: FloatArray) -> FloatArray:
        if not np.allclose(inertia, inertia.T):
            raise ValueError("is not symmetric")
        moments = np.linalg.eigvalsh(inertia)
        if moments[0] <= 0.0:
            raise ValueError("is not positive definite")
        if moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-9):
            raise ValueError(
                "breaks the triangle inequality: one principal moment exceeds the sum of the others"
            )
        return inertia

    @field_validator("parts")
    @classmethod
    def _part_names_differ(cls, parts: tuple[PartParameters, ...]) -> tuple[PartParameters, ...]:
        names = [part.name for part in parts]
        repeated = [name for index, name in enumerate(names) if name in names[:index]]
        if repeated:
            raise ValueError(f"two parts are named {repeated[0]!r}")
        return parts
