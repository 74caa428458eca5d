"""ENVISAT in detail, from its published dimensions; other dimensions are assumed, and marked as such."""

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from rpod_target.designs.design import Design, around, part, pose_on
from rpod_target.designs.envisat_payload import antennas, end_instruments, outer_instruments
from rpod_target.modelling.component import Component, along_x, bar, placed, pose
from rpod_target.modelling.shapes import (
    block,
    dome,
    frame,
    panel_row,
    tiles,
    tube,
)

_ABOUT = """
ENVISAT in detail, written by rpod_target/designs/envisat.py (python -m rpod_target.designs): change that
program, not this file. Axes as in envisat-slim and envisat-bulky: the origin is the centre of the main body,
x runs along body and solar array (the array lies at -x), y is the direction of flight, the Earth lies at -z.

Published dimensions:
- 26 m x 10 m x 5 m in orbit, x normal to the orbit plane: ESA, "Envisat space segment: overall configuration"
- body 10 m long, of which the payload module is 7 m: ESA, press release 26-2000.
- solar array 14 m x 5 m: ESA, on the image that Pleiades took of it in April 2012.
- ASAR antenna 10 m x 1.3 m, 20 tiles of 0.65 m x 1 m: radartutorial.eu, card "Envisat".
Assumed: 14 panels of the array, five of the antenna, all other dimensions and places, all materials.

Mass properties: as in envisat-slim.yaml, which names the sources.
"""
_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_BACK, _DOWN = (-1.0, 0.0, 0.0), (0.0, 0.0, -1.0)


@dataclass(frozen=True)
class Envisat:
    """Dimensions of ENVISAT, m. Those without a source in the parameter file are assumed."""

    half_length: float = 5.0
    """Half the length of the body."""
    service_length: float = 3.0
    """Length of the service module with the launch adapter: the body without the payload module of 7 m."""
    service_width: float = 2.8
    """Width of the octagonal service module over its flats (assumed)."""
    structure_end: float = 4.3
    """End of the payload module's structure along x; instruments fill the rest of the body (assumed)."""
    section: tuple[float, float] = (2.75, 2.1)
    """Payload module along y and z (assumed)."""
    ring_radius: float = 1.312
    """Radius of the launch adapter's ring: half of 2.624 m (assumed)."""
    arm: float = 2.0
    """Distance of the array from the body."""
    array: tuple[float, float] = (14.0, 5.0)
    """Length and width of the solar array."""
    panels: int = 14
    """Number of panels of the solar array."""
    array_height: float = 1.62
    """Height of the array's axis over that of the body (assumed)."""
    array_angle_deg: float = 25.0
    """Turn of the array about its axis, which is free on the real one (assumed)."""
    asar: tuple[float, float] = (1.3, 10.0)
    """Width and length of the ASAR antenna."""
    asar_panels: int = 5
    """Number of panels of the antenna."""
    asar_place: tuple[float, float] = (-0.9, -2.05)
    """Centre of the antenna along x and z (assumed)."""
    asar_tilt_deg: float = 20.0
    """Turn of the antenna about the direction of flight (assumed)."""

    def design(self) -> Design:
        """Return the target."""
        return Design(
            name="envisat-detailed",
            about=_ABOUT,
            components=(
                *_service_module(self),
                *_payload_module(self),
                *_array(self),
                *_asar(self),
                *antennas(self.section),
                *end_instruments(self.section, self.structure_end),
                *outer_instruments(self.section),
            ),
            mass={
                "centre_of_mass_m": [-3.86, -0.01, 0.0],
                "inertia_kg_m2": [
                    [17023.3, 397.1, -2171.4],
                    [397.1, 124825.7, 344.2],
                    [-2171.4, 344.2, 129112.2],
                ],
            },
            spacing_m=0.1,
            margin_m=2.0,
        )


def _service_module(d: Envisat) -> list[Component]:
    """Return the octagonal service module: its launch adapter lies at the -x end of the body."""
    base, end = -d.half_length + 0.45, -d.half_length + d.service_length
    across, middle = 0.5 * d.service_width, 0.5 * (base + end)
    octagon = trimesh.creation.cylinder(radius=across / np.cos(np.pi / 8.0), height=end - base, sections=8)
    body = placed(octagon, pose((0.0, 0.0, 0.0), Rotation.from_euler("z", np.pi / 8.0)))
    radiators, blankets, boxes = [], [], []
    for angle in 45.0 * np.arange(8):
        stand = pose_on(around(angle, across, middle), around(angle, 1.0, 0.0), _X)
        if angle in (0.0, 180.0):
            radiators += [placed(each, stand) for each in tiles((2.2, 1.0), (2, 1), gap=0.06, thick=0.03)]
        else:
            blankets += [placed(each, stand) for each in tiles((2.3, 1.05), (3, 1), gap=0.05, thick=0.02)]
        if angle in (45.0, 225.0, 315.0):
            boxes.append(placed(block((0.55, 0.45, 0.22), (0.3, 0.0, 0.1)), stand))
            boxes.append(placed(block((0.35, 0.3, 0.16), (-0.55, 0.1, 0.07)), stand))
    return [
        part("service-module", "gold-mli", placed(along_x(body), pose((middle, 0.0, 0.0))), *blankets),
        part("service-radiators", "white-paint", *radiators),
        part("service-boxes", "grey-panel", *boxes),
        *_launch_face(d, base),
    ]


def _launch_face(d: Envisat, base: float) -> list[Component]:
    """Return the ring of the launch adapter on its skirt, the tanks inside of it, and thrusters around it."""
    ring = placed(
        tube(d.ring_radius - 0.08, d.ring_radius, 0.06, 48), pose_on((-d.half_length, 0, 0), _X, _Y)
    )
    skirt = placed(
        tube(d.ring_radius - 0.06, d.ring_radius - 0.03, 0.46, 48),
        pose_on((-d.half_length + 0.03, 0, 0), _X, _Y),
    )
    gussets = [
        placed(
            block((0.36, 0.03, 0.08)), pose_on(around(angle, 1.29, base - 0.2), around(angle, 1.0, 0.0), _X)
        )
        for angle in 15.0 + 30.0 * np.arange(12)
    ]
    tanks = [
        placed(dome(0.4, 0.36, 16, steps=4), pose_on(around(angle, 0.62, base), _BACK, _Y))
        for angle in 45.0 + 90.0 * np.arange(4)
    ]
    thrusters = []
    for angle in 22.5 + 45.0 * np.arange(8):
        foot = around(angle, 0.5 * d.service_width + 0.02, base + 0.02)
        thrusters.append(placed(block((0.14, 0.1, 0.12)), pose_on(foot, around(angle, 1.0, 0.0), _X)))
        thrusters.append(placed(tube(0.012, 0.025, 0.14, 8, top=0.06), pose_on(foot, _BACK, _Y)))
    return [
        part("launch-adapter", "aluminium", ring, skirt, *gussets),
        part("propellant-tanks", "steel", *tanks),
        part("thrusters", "steel", *thrusters),
    ]


def _payload_module(d: Envisat) -> list[Component]:
    """Return the box of the payload module with frames and blankets; its -z face carries the instruments."""
    begin, end = -d.half_length + d.service_length, d.structure_end
    length, middle = end - begin + 0.02, 0.5 * (begin + end) - 0.01
    y, z = 0.5 * d.section[0], 0.5 * d.section[1]
    bays, covered = 4, end - begin - 0.1
    frames = [
        placed(
            frame((d.section[0] + 0.1, d.section[1] + 0.1), wide=0.1, thick=0.08), pose_on((x, 0, 0), _X, _Y)
        )
        for x in np.linspace(begin + 0.05, end - 0.05, bays + 1)
    ]
    silver = [
        placed(each, pose_on((middle, 0, z), _Z, _X))
        for each in tiles((covered, d.section[0] - 0.1), (bays, 2), gap=0.12, thick=0.025)
    ]
    black = [
        placed(each, pose_on((middle, side * y, 0), (0, side, 0), _X))
        for side in (-1.0, 1.0)
        for each in tiles((covered, d.section[1] - 0.1), (bays, 2), gap=0.12, thick=0.025)
    ]
    radiators = [
        placed(block((1.2, 0.75, 0.07)), pose_on((x, side * y, height), (0, side, 0), _X))
        for x, side, height in (
            (-1.2, 1, 0.45),
            (1.95, 1, 0.45),
            (1.95, 1, -0.45),
            (0.35, -1, 0.45),
            (3.5, -1, -0.45),
        )
    ]
    trays = [
        block((length - 0.3, 0.14, 0.12), (middle, -0.55, z + 0.03)),
        block((0.14, 1.2, 0.1), (0.1, -0.1, z + 0.03)),
        block((length - 1.5, 0.1, 0.12), (middle + 0.4, y + 0.03, -0.02)),
    ]
    brackets = [
        block((0.16, 0.24, 0.2), (x, side * (y + 0.08), -z + 0.1))
        for x in (-1.6, -0.2)
        for side in (-1.0, 1.0)
    ]
    return [
        part("payload-module", "black-mli", block((length, 2.0 * y, 2.0 * z), (middle, 0.0, 0.0)), *black),
        part("payload-blankets", "silver-mli", *silver),
        part("payload-frames", "aluminium", *frames),
        part("payload-radiators", "white-paint", *radiators),
        part("cable-trays", "grey-panel", *trays),
        part("hold-down-brackets", "steel", *brackets),
    ]


def _array(d: Envisat) -> list[Component]:
    """Return the solar array, turned about its axis, and the arm that carries it."""
    begin, pitch = -d.half_length - d.arm, d.array[0] / d.panels
    panel, gap = (d.array[1], pitch - 0.03), 0.03 * d.panels / (d.panels - 1)
    fronts, backs = panel_row(d.panels, panel, gap, 0.04, begin=0.0)
    cells, hinges = [], []
    for number in range(d.panels):
        centre = (0.0, number * (panel[1] + gap) + 0.5 * panel[1], 0.015)
        cells += [
            placed(each, pose(centre))
            for each in tiles((panel[0] - 0.06, panel[1] - 0.04), (5, 1), gap=0.04, thick=0.015)
        ]
        if number:
            edge = number * (panel[1] + gap) - 0.5 * gap
            hinges += [
                block((0.12, 0.2, 0.05), (share * panel[0], edge, -0.03))
                for share in (-0.42, -0.14, 0.14, 0.42)
            ]
    harness = [block((0.1, d.array[0] - 0.3, 0.03), (x, 0.5 * d.array[0], -0.03)) for x in (-0.9, 0.9)]
    # row along -x, its panels' x along y; then the array's turn about its axis
    lying = pose_on((begin, 0.0, d.array_height), _Z, _Y)
    turned = lying @ pose((0, 0, 0), Rotation.from_euler("y", d.array_angle_deg, degrees=True))
    yoke = [bar((0.0, -0.62, 0.0), (side * 1.3, 0.14, -0.07), 0.05, 8) for side in (-1.0, 1.0)]
    yoke.append(bar((-1.4, 0.1, -0.06), (1.4, 0.1, -0.06), 0.045, 8))
    return [
        part("array-panels", "black-paint", *(placed(each, turned) for each in (*fronts, *backs, *harness))),
        part("array-cells", "solar-cells", *(placed(each, turned) for each in cells)),
        part("array-hinges", "aluminium", *(placed(each, turned) for each in (*hinges, *yoke))),
        _arm(d, begin),
    ]


def _arm(d: Envisat, end: float) -> Component:
    """Return the arm from the drive on the service module to the yoke of the array, which begins at an x."""
    foot, axis = -d.half_length + 0.9, d.array_height
    return part(
        "array-arm",
        "aluminium",
        bar((foot - 0.2, 0.0, axis), (end + 0.5, 0.0, axis), 0.1, 16),
        block((0.9, 0.5, 0.34), (foot + 0.2, 0.0, 0.5 * d.service_width + 0.1)),
        bar((foot + 0.1, 0.0, axis), (foot - 0.35, 0.0, axis), 0.19, 20),
        block((0.3, 0.32, 0.3), (end + 0.58, 0.0, axis)),
        block((0.22, 0.28, 0.26), (-d.half_length - 0.35, 0.0, axis)),
    )


def _asar(d: Envisat) -> list[Component]:
    """Return the radar antenna: tiles below, frames and electronics above, struts to the body."""
    x, z = d.asar_place
    each = d.asar[1] / d.asar_panels
    tilted = pose((x, 0.0, z), Rotation.from_euler("y", d.asar_tilt_deg, degrees=True)) @ pose_on(
        (0, 0, 0), _DOWN, _X
    )
    faces, frames, boxes, hinges = [], [], [], []
    for number in range(d.asar_panels):
        place = tilted @ pose((0.0, (number - 0.5 * (d.asar_panels - 1)) * each, 0.0))
        faces += [
            placed(one, place) for one in tiles((d.asar[0], each - 0.02), (2, 2), gap=0.015, thick=0.05)
        ]
        frames.append(
            placed(frame((d.asar[0] - 0.04, each - 0.06), wide=0.08, thick=0.13), place @ pose((0, 0, -0.06)))
        )
        frames.append(placed(block((0.07, each - 0.1, 0.11), (0.0, 0.0, -0.05)), place))
        boxes += [
            placed(block((0.42, 0.3, 0.12), (i * 0.32, j * 0.5, -0.05)), place)
            for i in (-1.0, 1.0)
            for j in (-1.0, 1.0)
        ]
        if number:
            hinges += [
                placed(block((0.1, 0.14, 0.1), (i * 0.55, -0.5 * each, -0.1)), place)
                for i in (-1.0, 0.0, 1.0)
            ]
    bottom = -0.5 * d.section[1]
    struts = []
    for i in (-0.5, 0.5):
        for j in (-0.85, 0.85):
            foot = (tilted @ np.array((i, j, -0.1, 1.0)))[:3]
            struts += [
                bar(foot, (x + 1.6 * i, 0.9 * j, bottom + 0.05), 0.035, 8),
                bar(foot, (x - 0.5 * i, 1.2 * j, bottom + 0.05), 0.03, 8),
            ]
    return [
        part("asar-tiles", "white-paint", *faces),
        part("asar-frames", "black-paint", *frames),
        part("asar-boxes", "grey-panel", *boxes),
        part("asar-struts", "aluminium", *hinges, *struts),
    ]
