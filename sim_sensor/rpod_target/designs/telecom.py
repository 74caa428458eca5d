"""A geostationary telecommunication satellite, no particular one: the client of a life extension mission."""

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from rpod_schemas.arrays import FloatArray
from rpod_target.designs.design import Design, around, part, pose_on
from rpod_target.modelling.component import Component, bar, joined, placed, pose
from rpod_target.modelling.shapes import bell, block, dish, frame, panel_row, reflector, tiles, tube

_ABOUT = """
A geostationary telecommunication satellite with a span of 30 m, no particular one. It is a client of the kind
that a servicing vehicle docks to, at the nozzle of its apogee engine and the ring of its launch adapter.
Written by rpod_target/designs/telecom.py (python -m rpod_target.designs): change that program, not this file.
Axes: the origin is the centre of the bus, x points to the Earth (apogee engine and launch adapter lie at -x),
the solar arrays run along y.

Published: the diameter of the launch adapter's ring, 1.194 m (Proton Launch System Mission Planner's Guide,
revision 7, appendix D, adapter 1194VX). All else is assumed: dimensions, materials, and 2,400 kg spread
evenly over the surfaces.
"""
_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_BACK = (-1.0, 0.0, 0.0)


@dataclass(frozen=True)
class Telecom:
    """Dimensions of the satellite, m. All are assumed but the radius of the ring."""

    bus: tuple[float, float, float] = (4.2, 2.4, 2.2)
    """Bus along x, y, z."""
    ring_radius: float = 0.597
    """Radius of the launch adapter's ring: half of 1.194 m."""
    nozzle_radius: float = 0.16
    """Radius of the apogee engine's exit."""
    panels: int = 5
    """Number of panels of a wing."""
    panel: tuple[float, float] = (2.3, 2.4)
    """A panel's extent across and along the wing."""
    yoke: float = 1.4
    """Length of a wing's yoke."""
    wing_angle_deg: float = 25.0
    """Turn of the wings about y, from the cells facing the Earth."""
    reflectors: tuple[float, float, float] = (1.15, 0.9, 1.25)
    """Radii of the deployed reflectors: two at +z, one at -z."""

    def design(self) -> Design:
        """Return the target."""
        return Design(
            name="telecom-satellite",
            about=_ABOUT,
            components=(
                *_bus(self),
                *_docking_face(self),
                *_wings(self),
                *_reflectors(self),
                *_earth_deck(self),
            ),
            mass={"mass_kg": 2400.0, "mass_spread": "surface"},
            spacing_m=0.125,
            margin_m=2.0,
        )


def _bus(d: Telecom) -> list[Component]:
    """Return the bus: blankets on four sides, radiators on the sides of the wings, boxes."""
    x, y, z = 0.5 * np.array(d.bus)
    blankets: list[trimesh.Trimesh] = []
    mirrors: list[trimesh.Trimesh] = []
    rims = []
    for side in (-1.0, 1.0):
        east = pose_on((0.0, 0.0, side * z), (0.0, 0.0, side), _X)
        blankets += [
            placed(each, east) for each in tiles((d.bus[0], d.bus[1]), (3, 2), gap=0.06, thick=0.025)
        ]
        north = pose_on((0.0, side * y, 0.0), (0.0, side, 0.0), _X)
        mirrors += [
            placed(each, north)
            for each in tiles((d.bus[0] + 0.2, d.bus[2] + 0.1), (5, 3), gap=0.02, thick=0.04)
        ]
        rims.append(placed(frame((d.bus[0] + 0.3, d.bus[2] + 0.2), wide=0.06, thick=0.06), north))
        end = pose_on((side * x, 0.0, 0.0), (side, 0.0, 0.0), _Y)
        blankets += [placed(each, end) for each in tiles((d.bus[1], d.bus[2]), (2, 2), gap=0.06, thick=0.025)]
    boxes = [
        block((0.6, 0.45, 0.2), (-1.2, 0.5, z + 0.09)),
        block((0.4, 0.3, 0.16), (-1.3, -0.6, z + 0.07)),
        block((0.35, 0.5, 0.22), (-1.4, 0.2, -z - 0.1)),
    ]
    trays = [
        block((3.6, 0.12, 0.08), (0.1, -0.95, -z - 0.04)),
        block((3.0, 0.1, 0.08), (-0.3, 0.95, z + 0.04)),
    ]
    return [
        part("bus", "gold-mli", block(d.bus), *blankets),
        part("radiators", "aluminium", *mirrors, *rims),
        part("bus-boxes", "grey-panel", *boxes, *trays),
    ]


def _thrusters(d: Telecom) -> list[trimesh.Trimesh]:
    """Return pairs of thrusters at the corners of the -x face, and single ones at +z and -z."""
    x, y, z = 0.5 * np.array(d.bus)
    found = []
    for across in (-1.0, 1.0):
        for up in (-1.0, 1.0):
            foot = np.array((-x - 0.07, across * (y - 0.2), up * (z - 0.2)))
            found.append(block((0.16, 0.2, 0.2), foot))
            found += [
                placed(tube(0.012, 0.025, 0.16, 10, top=0.06), pose_on(foot, aim, along))
                for aim, along in (((-1.0, 0.0, 0.25 * up), _Y), ((-0.35, across, 0.0), _Z))
            ]
    for place in ((1.5, 0.0, z), (-0.9, 0.0, z), (1.5, 0.3, -z), (-0.9, -0.3, -z)):
        aim = (0.0, 0.0, np.sign(place[2]))
        found.append(block((0.14, 0.18, 0.12), place))
        found.append(placed(tube(0.012, 0.025, 0.17, 10, top=0.06), pose_on(place, aim, _X)))
    return found


def _docking_face(d: Telecom) -> list[Component]:
    """Return what a servicing vehicle meets: the adapter's ring around the nozzle of the apogee engine."""
    x = -0.5 * d.bus[0]
    radius, stand = d.ring_radius, pose_on((x + 0.01, 0.0, 0.0), _BACK, _Y)
    skirt = tube(radius - 0.03, radius + 0.05, 0.2, 40, top=radius - 0.015)
    ring = placed(tube(radius - 0.045, radius, 0.05, 40), pose((0.0, 0.0, 0.17)))
    pads = [block((0.06, 0.09, 0.09), around(45.0 + 90.0 * k, radius + 0.04, x - 0.14)) for k in range(4)]
    plugs = [block((0.1, 0.14, 0.1), around(angle, radius + 0.07, x - 0.08)) for angle in (0.0, 180.0)]
    nozzle = bell(0.05, d.nozzle_radius, 0.42, 28)
    shield = tube(0.09, 0.36, 0.02, 28, top=0.4)
    return [
        part("launch-adapter", "aluminium", placed(joined(skirt, ring), stand), *pads),
        part("adapter-plugs", "grey-panel", *plugs),
        part("apogee-nozzle", "steel", placed(nozzle, pose_on((x - 0.06, 0.0, 0.0), _X, _Y))),
        part("heat-shield", "silver-mli", placed(shield, pose_on((x - 0.02, 0.0, 0.0), _BACK, _Y))),
        part("thrusters", "steel", *_thrusters(d)),
    ]


def _wings(d: Telecom) -> list[Component]:
    """Return both wings: panels on a yoke; the southern one is the northern one turned by half a turn."""
    root, gap = 0.5 * d.bus[1] + 0.1, 0.04
    begin = root + d.yoke
    fronts, backs = panel_row(d.panels, d.panel, gap, 0.04, begin=begin)
    cells, hinges = [], []
    for number in range(d.panels):
        middle = begin + number * (d.panel[1] + gap) + 0.5 * d.panel[1]
        cells += [
            placed(each, pose((0.0, middle, 0.015)))
            for each in tiles((d.panel[0] - 0.06, d.panel[1] - 0.06), (2, 4), gap=0.04, thick=0.015)
        ]
        backs.append(
            placed(
                frame((d.panel[0] - 0.3, d.panel[1] - 0.3), wide=0.08, thick=0.03), pose((0, middle, -0.03))
            )
        )
        edge = middle - 0.5 * d.panel[1] - 0.5 * gap
        hinges += [block((0.1, 0.16, 0.05), (share * d.panel[0], edge, -0.03)) for share in (-0.35, 0.35)]
    foot = np.array((0.0, root + 0.15, 0.0))
    yoke = [bar(foot, (side * 0.35 * d.panel[0], begin - 0.03, -0.03), 0.035, 8) for side in (-1.0, 1.0)]
    yoke.append(
        bar(
            (-0.22 * d.panel[0], begin - 0.5, -0.02),
            (0.22 * d.panel[0], begin - 0.5, -0.02),
            0.025,
            8,
        )
    )
    drive = bar((0.0, root - 0.12, 0.0), (0.0, root + 0.2, 0.0), 0.13, 20)
    turn = Rotation.from_euler("y", 90.0 - d.wing_angle_deg, degrees=True)
    found = []
    # a half turn about the x axis of the satellite gives the other wing; its cells must face the same way
    for name, wing in (
        ("north", turn),
        ("south", Rotation.from_euler("z", 180.0, degrees=True) * turn.inv()),
    ):
        stand = pose((0.0, 0.0, 0.0), wing)
        found += [
            part(f"{name}-panels", "black-paint", *(placed(each, stand) for each in (*fronts, *backs))),
            part(f"{name}-cells", "solar-cells", *(placed(each, stand) for each in cells)),
            part(f"{name}-yoke", "aluminium", *(placed(each, stand) for each in (drive, *yoke, *hinges))),
        ]
    return found


def _reflector(
    radius: float, stand: FloatArray, hinge: FloatArray
) -> tuple[trimesh.Trimesh, list[trimesh.Trimesh]]:
    """Return a reflector at a pose, and its backing ring with ribs and the arm to its hinge."""
    depth = 0.16 * radius
    shell = placed(reflector(radius, depth, 0.025 * radius, 28), stand)
    ring = placed(tube(0.52 * radius, 0.56 * radius, 0.09, 24), stand @ pose((0.0, 0.0, -0.05)))
    structure = [ring]
    for k in range(6):
        angle = np.pi / 3.0 * k
        tip = np.array((np.cos(angle), np.sin(angle), 0.0))
        ends = [
            stand @ np.array((*(share * radius * tip[:2]), height, 1.0))
            for share, height in ((0.1, -0.03), (0.9, 0.72 * depth))
        ]
        structure.append(bar(ends[0][:3], ends[1][:3], 0.02, 6))
    back = (stand @ np.array((0.0, 0.0, -0.04, 1.0)))[:3]
    structure += [bar(hinge + np.array((0.0, across, 0.0)), back, 0.035, 8) for across in (-0.25, 0.25)]
    structure.append(block((0.18, 0.7, 0.12), hinge))
    return shell, structure


def _reflectors(d: Telecom) -> list[Component]:
    """Return the deployed reflectors on their arms."""
    z = 0.5 * d.bus[2]
    shells, structures = [], []
    for radius, across, side in zip(d.reflectors, (0.62, -0.72, 0.1), (1.0, 1.0, -1.0), strict=True):
        centre = (0.15 if across > 0.0 else 0.75, 2.1 * across, side * (z + 0.45 + radius))
        shell, structure = _reflector(
            radius,
            pose_on(centre, (1.0, -0.15 * across, -0.5 * side), _Y),
            np.array((-0.9, 0.8 * across, side * (z + 0.05))),
        )
        shells.append(shell)
        structures += structure
    return [part("reflectors", "white-paint", *shells), part("reflector-arms", "black-paint", *structures)]


def _earth_deck(d: Telecom) -> list[Component]:
    """Return what stands on the +x face: feeds, a small antenna on a tower, sensors, a mast."""
    x = 0.5 * d.bus[0]
    horns = []
    for across, up, aim in ((0.55, 0.75, 0.45), (-0.6, 0.75, 0.45), (0.1, -0.8, -0.45), (-0.35, -0.8, -0.4)):
        stand = pose_on((x - 0.02, across, up), (1.0, 0.0, aim), _Y)
        horns.append(placed(tube(0.04, 0.06, 0.55, 16, top=0.2), stand))
        horns.append(placed(block((0.24, 0.24, 0.18)), stand))
    tower = [
        block((0.75, 0.75, 0.55), (x + 0.35, -0.05, 0.0)),
        placed(frame((0.9, 0.7), wide=0.06, thick=0.06), pose_on((x + 0.75, -0.05, 0.0), _X, _Y)),
    ]
    sub_dish, sub_feed = dish(0.38, 24, pose_on((x + 0.85, -0.05, 0.05), (1.0, 0.15, 0.1), _Y))
    mast = [
        bar((x, 0.95, -0.7), (x + 1.4, 0.95, -0.7), 0.03, 8),
        bar((x, 0.6, -0.7), (x + 0.7, 0.95, -0.7), 0.02, 6),
    ]
    omni = placed(tube(0.03, 0.07, 0.3, 12, top=0.06), pose_on((x + 1.38, 0.95, -0.7), _X, _Y))
    trackers, feet = [], []
    for across, up, tilt in ((0.95, 0.35, 0.6), (-0.95, 0.4, -0.6)):
        trackers.append(
            placed(tube(0.085, 0.1, 0.36, 16), pose_on((x + 0.12, across, up), (0.7, tilt, 0.2), _Z))
        )
        feet.append(block((0.2, 0.22, 0.22), (x + 0.09, across, up)))
    sensors = [
        block((0.22, 0.2, 0.16), (x + 0.1, -0.85, -0.3)),
        block((0.22, 0.2, 0.16), (x + 0.1, -0.85, -0.6)),
        block((0.14, 0.14, 0.1), (-x - 0.05, 0.9, 0.0)),
    ]
    return [
        part("feed-horns", "aluminium", *horns),
        part("feed-tower", "gold-mli", *tower),
        part("small-dish", "white-paint", sub_dish),
        part("masts", "aluminium", sub_feed, *mast, omni),
        part("star-trackers", "black-paint", *trackers),
        part("earth-sensors", "grey-panel", *feet, *sensors),
    ]
