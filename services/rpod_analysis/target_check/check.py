"""Check of a target: its properties and how well methods work on it, as numbers."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from rpod_analysis.target_check.accuracy import SensorAccuracy, expected_accuracy
from rpod_analysis.target_check.edges import Edge, straight_edges
from rpod_analysis.target_check.holes import Opening, openings
from rpod_analysis.target_check.likeness import checked_symmetries
from rpod_analysis.target_check.trials import MethodFacts, try_methods
from rpod_pose.registration.closest_point import Surface
from rpod_target import Target
from rpod_target.mesh.topology import areas_m2
from rpod_target.symmetry import FoundSymmetry, agreeing_share

_DOUBTFUL_SHARE = 0.6
"""Share of agreeing surface below which a declared exact symmetry is doubted; the search finds none below."""
_LISTED = 20
"""Number of openings and edges that are listed one by one, the longest."""


@dataclass(frozen=True)
class Size:
    """Bounding box of a target."""

    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]
    sides_m: tuple[float, float, float]
    longest_side_m: float
    radius_m: float
    """Radius of the sphere about the origin that holds the target."""


@dataclass(frozen=True)
class PartFacts:
    """A part of a target."""

    name: str
    triangles: int
    area_m2: float
    sides_m: tuple[float, float, float]
    materials: tuple[str, ...]
    unreliable: bool = False
    """Whether the estimator ignores it."""


@dataclass(frozen=True)
class MaterialFacts:
    """A material of a target."""

    name: str
    looks: str
    """Class of brightness, which is all that an estimator knows."""
    reflectivity: float
    diffuse: float
    f0: float
    area_share: float


@dataclass(frozen=True)
class FieldFacts:
    """The distance field."""

    nodes: tuple[int, ...]
    spacing_m: float
    megabytes: float
    volume_inside_m3: float
    """Volume of the nodes inside; sheets and panels thinner than the spacing have none."""


@dataclass(frozen=True)
class MassFacts:
    """Mass properties."""

    centre_of_mass_m: tuple[float, ...]
    inertia_kg_m2: tuple[tuple[float, ...], ...]
    principal_moments_kg_m2: tuple[float, ...]


@dataclass(frozen=True)
class FrameFacts:
    """A frame that a target's file names."""

    name: str
    place_m: tuple[float, float, float]
    euler_321_deg: tuple[float, float, float]
    """Yaw, pitch and roll from the target's axes."""
    from_surface_m: float
    """Distance of its place from the surface; a large one is likely a mistake."""


@dataclass(frozen=True)
class TargetCheck:
    """All results of a check."""

    name: str
    file: str
    digest: str
    size: Size
    triangles: int
    model_points: int
    parts: tuple[PartFacts, ...]
    materials: tuple[MaterialFacts, ...]
    repairs: tuple[str, ...]
    openings: int
    longest_openings: tuple[Opening, ...]
    declared_symmetries: tuple[dict[str, Any], ...]
    """Those of the file, each with the share of the surface that agrees nearly after its worst turn."""
    found_symmetries: tuple[FoundSymmetry, ...]
    frames: tuple[FrameFacts, ...]
    mass: MassFacts
    distance_field: FieldFacts
    edges: int
    longest_edges: tuple[Edge, ...]
    edges_seen: dict[str, dict[str, int]]
    """Number of edges that a sensor resolves, by sensor and by range, m."""
    accuracy: tuple[SensorAccuracy, ...]
    methods: tuple[MethodFacts, ...]

    @property
    def doubts(self) -> tuple[str, ...]:
        """Declared exact symmetries that the surface does not have, one sentence each."""
        exact = (one for one in self.declared_symmetries if one["exact"])
        return tuple(_doubt(one) for one in exact if one["share"] < _DOUBTFUL_SHARE)

    def document(self) -> dict[str, Any]:
        """Return the check as a JSON document."""
        return asdict(self)


def check_target(target: Target, *, trials: int | None = None) -> TargetCheck:
    """Return the properties of a target, and how well methods work on it.

    Args:
        target: the target.
        trials: number of frames of each sensor on which methods are tried; by default as many as take 20 s.

    Raises:
        rpod_target.TargetError: the target has no distance field.
    """
    rims, edges, accuracy = openings(target), straight_edges(target), expected_accuracy(target)
    return TargetCheck(
        name=target.name,
        file=target.source,
        digest=target.digest,
        size=_size(target),
        triangles=len(target.triangles_m),
        model_points=len(target.model_points_m),
        parts=tuple(_part(target, number) for number in range(len(target.parts))),
        materials=_materials(target),
        repairs=target.repairs,
        openings=len(rims),
        longest_openings=tuple(rims[:_LISTED]),
        declared_symmetries=tuple(
            asdict(one) | {"share": agreeing_share(target, one)} for one in target.symmetries
        ),
        found_symmetries=tuple(checked_symmetries(target)),
        frames=tuple(described_frame(target, name) for name in target.frames),
        mass=_mass(target),
        distance_field=_field(target),
        edges=len(edges),
        longest_edges=tuple(edges[:_LISTED]),
        edges_seen={
            sensor.sensor: {
                f"{at.range_m:.4g}": sum(edge.seen_up_to_m[sensor.sensor] >= at.range_m for edge in edges)
                for at in sensor.ranges
            }
            for sensor in accuracy
        },
        accuracy=accuracy,
        methods=try_methods(target, trials=trials),
    )


def _doubt(one: dict[str, Any]) -> str:
    """Return what a symmetry that the file declares and the surface does not have leads to."""
    along = ", ".join(f"{value:.3f}" for value in one["axis"])
    turn = "any turn" if one["continuous"] else f"every {360 / one['order']:.4g} deg"
    return (
        f"the file declares an exact symmetry about ({along}), {turn}, after which only {one['share']:.0%} "
        "of the surface agrees: poses that differ by it count as equal; correct it or take it out"
    )


def _triple(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _size(target: Target) -> Size:
    low_m, high_m = target.triangles_m.min(axis=(0, 1)), target.triangles_m.max(axis=(0, 1))
    return Size(
        _triple(low_m),
        _triple(high_m),
        _triple(high_m - low_m),
        float((high_m - low_m).max()),
        target.radius_m,
    )


def _part(target: Target, number: int) -> PartFacts:
    chosen = target.triangle_part == number
    triangles_m = target.triangles_m[chosen]
    if not len(triangles_m):
        return PartFacts(target.parts[number], 0, 0.0, (0.0, 0.0, 0.0), ())
    used = np.unique(target.triangle_material[chosen])
    known = target.parts if target.reliable is None else target.reliable.parts
    return PartFacts(
        target.parts[number],
        len(triangles_m),
        float(areas_m2(triangles_m).sum()),
        _triple(np.ptp(triangles_m, axis=(0, 1))),
        tuple(target.materials[index].name for index in used),
        unreliable=target.parts[number] not in known,
    )


def _materials(target: Target) -> tuple[MaterialFacts, ...]:
    area_m2 = np.bincount(
        target.triangle_material, weights=areas_m2(target.triangles_m), minlength=len(target.materials)
    )
    return tuple(
        MaterialFacts(
            each.name, each.looks, each.reflectivity, each.diffuse, each.f0, float(area / area_m2.sum())
        )
        for each, area in zip(target.materials, area_m2, strict=True)
    )


def described_frame(target: Target, name: str) -> FrameFacts:
    """Return the result of a check for a frame of the target."""
    pose = target.frames[name]
    surface = Surface.of(target.triangles_m, target.normals)
    place_m = pose.translation[None]
    closest_m = surface.closest(place_m, np.ones(len(target.triangles_m), np.bool_), np.zeros(1, np.int32))
    return FrameFacts(
        name,
        _triple(pose.translation),
        _triple(pose.rotation.as_euler("ZYX", degrees=True)),
        float(np.linalg.norm(closest_m - place_m)),
    )


def _mass(target: Target) -> MassFacts:
    return MassFacts(
        tuple(target.centre_of_mass_m.tolist()),
        tuple(tuple(row) for row in target.inertia_kg_m2.tolist()),
        tuple(np.linalg.eigvalsh(target.inertia_kg_m2).tolist()),
    )


def _field(target: Target) -> FieldFacts:
    field = target.require_field()
    inside = int(np.count_nonzero(field.values < 0.0))
    return FieldFacts(
        field.values.shape, field.spacing_m, field.values.nbytes / 1e6, inside * field.spacing_m**3
    )
