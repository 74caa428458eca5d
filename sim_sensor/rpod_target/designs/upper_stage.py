"""A spent rocket stage with separate tanks, no particular one: a target of debris removal."""

from dataclasses import dataclass

import numpy as np
import trimesh

from rpod_target.designs.design import Design, around, part, pose_on
from rpod_target.modelling.component import Component, bar, placed, pose
from rpod_target.modelling.shapes import bell, block, dome, ellipsoid, frame, tube
from rpod_target.parameters import MaterialParameters

_ABOUT = """
A spent upper stage for hydrogen and oxygen in separate tanks, no particular one: a large target of debris
removal. Written by rpod_target/designs/upper_stage.py (python -m rpod_target.designs): change that program,
not this file. Axes: x runs along the stage, the nozzle lies at -x, the ring of the payload adapter at +x. The
origin is the middle of the hydrogen tank's cylinder.

Published: the diameter, 4 m, is that of the H-IIA (Spaceflight101, "H-IIA launch vehicle"); the ring of the
payload adapter, 1.666 m (Proton Launch System Mission Planner's Guide, revision 7, appendix D, adapter
1666V). All else is assumed: dimensions, materials, and 3,000 kg spread evenly over the surfaces.

A tunnel, two lines, thruster pods and boxes are all that tells its attitudes about x apart: it is nearly
symmetric to any turn about x, of which the file declares twelve.
"""
_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_BACK = (-1.0, 0.0, 0.0)
_FOAM = MaterialParameters(reflectivity=0.45, diffuse=0.4, f0=0.03, roughness=0.5, albedo="grey")
_SIDES = 48
"""Number of facets of the stage's round parts."""


@dataclass(frozen=True)
class UpperStage:
    """Dimensions of the stage, m. All are assumed but the two radii with a source in the parameter file."""

    radius: float = 2.0
    """Radius of the hydrogen tank."""
    barrel: float = 4.4
    """Length of the hydrogen tank's cylinder."""
    dome_height: float = 1.2
    """Height of its domes."""
    skirt: float = 0.6
    """Length of the skirts fore and aft."""
    adapter: float = 1.1
    """Length of the payload adapter's cone."""
    ring_radius: float = 0.833
    """Radius of the payload adapter's ring: half of 1.666 m."""
    oxygen: tuple[float, float] = (1.45, 1.05)
    """Half axes of the oxygen tank, across and along x."""
    oxygen_place: float = -4.15
    """Centre of the oxygen tank."""
    nozzle: tuple[float, float, float] = (0.14, 0.85, 1.9)
    """Throat radius, exit radius and length of the nozzle."""
    stringers: int = 36
    """Number of stringers on each skirt."""

    def design(self) -> Design:
        """Return the target."""
        return Design(
            name="upper-stage",
            about=_ABOUT,
            components=(
                *_hydrogen_tank(self),
                *_payload_adapter(self),
                *_oxygen_tank(self),
                *_engine(self),
                *_outside(self),
            ),
            mass={"mass_kg": 3000.0, "mass_spread": "surface"},
            spacing_m=0.075,
            margin_m=1.5,
            symmetries=({"axis": list(_X), "order": 12},),
            own_materials={"foam": _FOAM},
        )


def _ring(
    inner: float, outer: float, begin: float, length: float, *, top: float | None = None
) -> trimesh.Trimesh:
    """Return a tube about x."""
    return placed(tube(inner, outer, length, _SIDES, top=top), pose_on((begin, 0.0, 0.0), _X, _Y))


def _stringers(d: UpperStage, begin: float) -> list[trimesh.Trimesh]:
    """Return the stringers on a skirt that begins at an x."""
    return [
        placed(
            block((d.skirt - 0.1, 0.05, 0.06)),
            pose_on(around(angle, d.radius + 0.04, begin + 0.5 * d.skirt), around(angle, 1.0, 0.0), _X),
        )
        for angle in np.arange(d.stringers) * 360.0 / d.stringers
    ]


def _hydrogen_tank(d: UpperStage) -> list[Component]:
    """Return the domed tank with the lands of its welds, and the skirts at its ends."""
    half = 0.5 * d.barrel
    barrel = trimesh.creation.cylinder(radius=d.radius, height=d.barrel, sections=_SIDES)
    fore = placed(
        dome(d.radius - 0.01, d.dome_height, _SIDES, steps=5), pose_on((half - 0.01, 0.0, 0.0), _X, _Y)
    )
    aft = placed(
        dome(d.radius - 0.01, d.dome_height, _SIDES, steps=5), pose_on((0.01 - half, 0.0, 0.0), _BACK, _Y)
    )
    lands = [
        _ring(d.radius - 0.02, d.radius + 0.018, x - 0.05, 0.1)
        for x in np.linspace(-half + 0.7, half - 0.7, 4)
    ]
    return [
        part("hydrogen-tank", "foam", placed(barrel, pose_on((0.0, 0.0, 0.0), _X, _Y)), fore, aft, *lands),
        part(
            "skirts",
            "grey-panel",
            _ring(d.radius - 0.03, d.radius + 0.025, half, d.skirt),
            _ring(d.radius - 0.03, d.radius + 0.025, -half - d.skirt, d.skirt),
            *_stringers(d, half),
            *_stringers(d, -half - d.skirt),
        ),
    ]


def _payload_adapter(d: UpperStage) -> list[Component]:
    """Return the equipment around the cone of the payload adapter, and its ring."""
    shelf = 0.5 * d.barrel + d.skirt
    end = shelf + d.adapter
    cone = _ring(1.48, 1.52, shelf - 0.05, d.adapter, top=d.ring_radius + 0.01)
    ring = _ring(d.ring_radius - 0.07, d.ring_radius, end - 0.08, 0.1)
    pushers = [
        placed(
            tube(0.02, 0.05, 0.2, 8),
            pose_on(around(30.0 + 90.0 * k, d.ring_radius - 0.13, end - 0.16), _X, _Y),
        )
        for k in range(4)
    ]
    boxes = []
    for angle, size in (
        (20, 0.5),
        (60, 0.35),
        (105, 0.6),
        (150, 0.3),
        (200, 0.45),
        (245, 0.3),
        (290, 0.55),
        (335, 0.35),
    ):
        stand = pose_on(around(angle, 1.72, shelf + 0.12), _X, around(angle, 1.0, 0.0))
        boxes.append(placed(block((0.34, size, 0.3)), stand))
    harness = [_ring(1.54, 1.58, shelf + 0.03, 0.05)]
    return [
        part("equipment-shelf", "aluminium", _ring(1.4, d.radius + 0.01, shelf - 0.03, 0.05)),
        part("equipment", "black-paint", *boxes, *harness),
        part("adapter-cone", "black-paint", cone),
        part("payload-ring", "aluminium", ring, *pushers),
    ]


def _oxygen_tank(d: UpperStage) -> list[Component]:
    """Return the oxygen tank, the truss that carries it, and pressure bottles."""
    across, along = d.oxygen
    place = d.oxygen_place
    top = -0.5 * d.barrel - d.skirt + 0.05
    tank = placed(ellipsoid(across, along, 40, steps=10), pose_on((place, 0.0, 0.0), _X, _Y))
    belt = _ring(across - 0.05, across + 0.05, place - 0.07, 0.14)
    truss = []
    for k in range(8):
        foot = around(45.0 * k, across + 0.02, place)
        truss += [bar(foot, around(45.0 * k + turn, d.radius - 0.02, top), 0.05, 8) for turn in (-18.0, 18.0)]
    bottles = [
        placed(ellipsoid(0.33, 0.33, 20, steps=8), pose(around(angle, across + 0.12, place + 0.5)))
        for angle in (68.0, 158.0, 203.0)
    ]
    bottles.append(placed(ellipsoid(0.24, 0.24, 20, steps=8), pose(around(292.0, across + 0.1, place + 0.3))))
    mounts = [
        bar(around(angle, across - 0.05, place + 0.02), around(angle, across + 0.12, place + 0.5), 0.05, 8)
        for angle in (68.0, 158.0, 203.0, 292.0)
    ]
    return [
        part("oxygen-tank", "silver-mli", tank),
        part("oxygen-belt", "aluminium", belt, *mounts),
        part("truss", "black-paint", *truss),
        part("pressure-bottles", "steel", *bottles),
    ]


def _engine(d: UpperStage) -> list[Component]:
    """Return the engine below the oxygen tank."""
    throat, exit_radius, length = d.nozzle
    gimbal = d.oxygen_place - d.oxygen[1] - 0.25
    seat = gimbal - 0.55
    frame_bars = [
        bar(around(60.0 * k, 0.95, d.oxygen_place - 0.72), around(60.0 * k, 0.16, gimbal), 0.045, 8)
        for k in range(6)
    ]
    chamber = placed(tube(0.08, 0.2, 0.55, 24, top=throat + 0.02), pose_on((gimbal, 0.0, 0.0), _BACK, _Y))
    pumps = [
        bar((gimbal - 0.1, 0.42, 0.1), (gimbal - 0.65, 0.42, 0.1), 0.14, 16),
        bar((gimbal - 0.1, -0.38, -0.12), (gimbal - 0.5, -0.38, -0.12), 0.12, 16),
        bar((gimbal - 0.35, 0.42, 0.1), (gimbal - 0.45, 0.0, 0.0), 0.06, 8),
        bar((gimbal - 0.3, -0.38, -0.12), (gimbal - 0.4, 0.0, 0.0), 0.06, 8),
        block((0.3, 0.22, 0.26), (gimbal - 0.25, 0.05, 0.36)),
    ]
    actuators = [
        bar(around(angle, 0.7, d.oxygen_place - 0.85), around(angle, 0.3, seat - 0.35), 0.035, 8)
        for angle in (90.0, 180.0)
    ]
    hoops = [
        _ring(radius - 0.02, radius + 0.03, seat - share * length, 0.05)
        for share, radius in ((0.45, 0.63), (0.75, 0.77), (0.995, 0.855))
    ]
    return [
        part("engine-frame", "aluminium", *frame_bars),
        part("engine", "steel", chamber, *pumps, *actuators),
        part(
            "nozzle",
            "steel",
            placed(bell(throat, exit_radius, length, 36), pose_on((seat, 0.0, 0.0), _X, _Y)),
            *hoops,
        ),
    ]


def _outside(d: UpperStage) -> list[Component]:
    """Return the details that distinguish the attitudes about x: tunnel, lines, thruster pods, hatch."""
    half = 0.5 * d.barrel
    place = d.oxygen_place

    def on(angle: float, x: float, size: tuple[float, float, float]) -> trimesh.Trimesh:
        """Return a block on the tank's surface: its extent along x, around it, and outwards."""
        stand = pose_on(around(angle, d.radius + 0.5 * size[2] - 0.02, x), around(angle, 1.0, 0.0), _X)
        return placed(block(size), stand)

    tunnel = [on(0.0, 0.0, (d.barrel + 2.0 * d.skirt - 0.1, 0.34, 0.16))]
    tunnel += [on(0.0, x, (0.08, 0.42, 0.2)) for x in np.linspace(-half, half, 6)]
    feed = [
        around(130.0, d.radius + 0.1, -half + 0.5),
        around(130.0, d.radius + 0.1, -half - 0.7),
        around(130.0, 0.4, place - 1.35),
    ]
    vent = [around(250.0, d.radius + 0.07, half - 0.2), around(250.0, d.radius + 0.07, -half - d.skirt - 0.3)]
    lines = [
        bar(feed[0], feed[1], 0.1, 12),
        bar(feed[1], feed[2], 0.09, 12),
        bar(vent[0], vent[1], 0.06, 10),
        *(on(130.0, -half + x, (0.1, 0.3, 0.14)) for x in (0.4, -0.2)),
        *(on(250.0, x, (0.08, 0.2, 0.12)) for x in np.linspace(-half + 0.4, half - 0.4, 4)),
    ]
    pods, thrusters = [], []
    for angle in (85.0, 265.0):
        pods.append(on(angle, -half - 0.5 * d.skirt, (0.45, 0.5, 0.26)))
        foot = around(angle, d.radius + 0.2, -half - 0.5 * d.skirt)
        side = around(angle + 90.0, 1.0, 0.0)
        thrusters += [
            placed(tube(0.02, 0.04, 0.42, 12, top=0.1), pose_on(foot, aim, around(angle, 1.0, 0.0)))
            for aim in (np.array(_BACK), side, -side)
        ]
    patches = [on(angle, half + 0.3, (0.26, 0.3, 0.1)) for angle in (45.0, 135.0, 225.0, 315.0)]
    hatch = placed(
        frame((0.42, 0.6), wide=0.05, thick=0.05),
        pose_on(around(180.0, d.radius + 0.02, half + 0.3), around(180.0, 1.0, 0.0), _X),
    )
    return [
        part("tunnel", "white-paint", *tunnel),
        part("lines", "silver-mli", *lines),
        part("thruster-pods", "white-paint", *pods, *patches),
        part("thrusters", "steel", *thrusters),
        part("hatch", "aluminium", hatch),
    ]
