"""The payload of ENVISAT: antennas and instruments; sources and assumptions are in ``envisat.py``."""

import numpy as np
import trimesh

from rpod_schemas.arrays import FloatArray
from rpod_target.designs.design import part, pose_on
from rpod_target.modelling.component import Component, bar, placed, pose
from rpod_target.modelling.shapes import block, dish, dome, tube

Section = tuple[float, float]
"""Width along y and height along z of the structure, m."""
_X, _Y = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
_DOWN = (0.0, 0.0, -1.0)


def antennas(section: Section) -> list[Component]:
    """Return the Ka-band antenna on its mast, altimeter, radiometer, and small antennas."""
    top, bottom = 0.5 * section[1], -0.5 * section[1]
    gimbal = np.array((3.9, 0.5, 2.35))
    ka_dish, ka_feed = dish(0.45, 28, pose_on((4.02, 0.5, 2.53), (0.5, 0.2, 0.85), _Y))
    mast = [
        bar((3.9, 0.5, top - 0.02), gimbal, 0.055, 12),
        bar((3.4, 0.5, top), (3.9, 0.5, 1.7), 0.025, 8),
        bar((3.9, 0.0, top), (3.9, 0.5, 1.7), 0.025, 8),
        placed(block((0.26, 0.22, 0.3)), pose(gimbal)),
    ]
    ra2_dish, ra2_feed = dish(0.6, 32, pose_on((1.35, 0.55, bottom - 0.28), _DOWN, _X))
    ra2_stand = tube(0.2, 0.28, 0.3, 20, top=0.2)
    mwr_dish, mwr_feed = dish(0.3, 20, pose_on((2.0, -1.0, bottom - 0.55), (0.1, 0.6, -0.8), _X))
    return [
        part("ka-band-antenna", "white-paint", ka_dish),
        part("ka-band-mast", "aluminium", ka_feed, *mast),
        part("ra-2-antenna", "aluminium", ra2_dish),
        part(
            "ra-2-feed",
            "steel",
            ra2_feed,
            placed(ra2_stand, pose_on((1.35, 0.55, bottom + 0.01), _DOWN, _X)),
            mwr_feed,
        ),
        part(
            "mwr",
            "grey-panel",
            block((0.55, 0.5, 0.5), (1.95, -1.0, bottom - 0.2)),
            mwr_dish,
        ),
        part(
            "small-antennas",
            "white-paint",
            placed(tube(0.16, 0.2, 0.42, 20, top=0.1), pose_on((3.95, 0.95, bottom + 0.02), _DOWN, _X)),
            placed(tube(0.02, 0.07, 0.3, 12, top=0.16), pose_on((0.45, -0.6, bottom + 0.02), _DOWN, _X)),
            placed(tube(0.02, 0.07, 0.3, 12, top=0.16), pose_on((0.45, -1.1, bottom + 0.02), _DOWN, _X)),
            bar((-1.7, 1.1, top), (-1.7, 1.5, top + 0.9), 0.025, 8),
            placed(tube(0.01, 0.07, 0.25, 10), pose_on((-1.7, 1.5, top + 0.85), (0.0, 0.4, 0.9), _X)),
        ),
        part(
            "retro-reflector",
            "steel",
            placed(dome(0.11, 0.1, 16, steps=4), pose_on((3.3, 1.0, bottom + 0.01), _DOWN, _X)),
        ),
    ]


def end_instruments(section: Section, end: float) -> list[Component]:
    """Return the instruments at the +x end of a structure, which is at ``end``, and MERIS below it."""
    bottom = -0.5 * section[1]
    return [
        part(
            "meris",
            "gold-mli",
            block((1.0, 1.5, 0.75), (3.0, -0.15, bottom - 0.35)),
            *(block((0.12, 0.16, 0.1), (2.7 + 0.15 * k, -0.7 + 0.27 * k, bottom - 0.75)) for k in range(5)),
        ),
        part(
            "mipas",
            "silver-mli",
            block((0.7, 1.25, 0.8), (end + 0.34, 0.7, 0.25)),
            placed(block((0.5, 0.45, 1.1)), pose_on((end + 0.4, 1.2, 0.75), (0.0, 0.35, 0.94), _X)),
        ),
        part(
            "sciamachy",
            "gold-mli",
            block((0.6, 1.15, 0.85), (end + 0.29, -0.72, 0.35)),
            block((0.35, 0.6, 0.3), (end + 0.17, -0.72, -0.2)),
        ),
        part(
            "cooler-radiators",
            "white-paint",
            block((0.04, 1.0, 0.7), (end + 0.61, -0.72, 0.35)),
            block((0.5, 0.05, 0.6), (end + 0.3, -1.32, 0.35)),
        ),
        part(
            "gomos",
            "black-mli",
            block((0.65, 0.8, 0.6), (end + 0.31, 0.35, -0.62)),
            _baffle(0.26, 0.5, pose_on((end + 0.33, -0.02, -0.62), (0.0, -1.0, 0.0), _X)),
        ),
    ]


def outer_instruments(section: Section) -> list[Component]:
    """Return AATSR on the side, star trackers on top, and boxes."""
    y, top, bottom = 0.5 * section[0], 0.5 * section[1], -0.5 * section[1]
    return [
        part(
            "aatsr",
            "silver-mli",
            block((0.9, 0.55, 0.8), (3.3, y + 0.25, -0.45)),
            _baffle(0.17, 0.3, pose_on((3.05, y + 0.27, bottom + 0.23), _DOWN, _X)),
            _baffle(0.17, 0.35, pose_on((3.55, y + 0.27, bottom + 0.3), (0.0, 0.5, -0.85), _X)),
        ),
        part(
            "star-trackers",
            "black-paint",
            *(
                _baffle(0.11, 0.38, pose_on((x, across, top + 0.05), (tilt, 0.3, 0.9), _X))
                for x, across, tilt in ((-0.9, 0.8, 0.4), (-1.2, 0.3, -0.4), (2.7, -0.95, 0.3))
            ),
            *(
                block((0.24, 0.24, 0.14), (x, across, top + 0.06))
                for x, across in ((-0.9, 0.8), (-1.2, 0.3), (2.7, -0.95))
            ),
        ),
        part(
            "payload-boxes",
            "grey-panel",
            block((0.7, 0.5, 0.3), (1.1, 0.7, top + 0.14)),
            block((0.45, 0.4, 0.25), (2.0, 0.6, top + 0.11)),
            block((0.6, 0.2, 0.5), (-0.4, -y - 0.09, -0.5)),
            block((0.5, 0.25, 0.45), (1.9, -y - 0.11, -0.5)),
            block((0.35, 0.2, 0.3), (2.7, -y - 0.09, 0.5)),
        ),
    ]


def _baffle(radius: float, length: float, stand: FloatArray) -> trimesh.Trimesh:
    return placed(tube(0.82 * radius, radius, length, 20), stand)
