"""Main bodies of the random satellites: box, hexagonal and octagonal prism, cylinder, truss.

A body is centred on the origin with its axis along x. Its longest side is 1 before the satellite is scaled.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import trimesh
from numpy.random import Generator

from rpod_schemas.arrays import FloatArray
from rpod_target.modelling.component import Component, along_x, bar, joined, placed, pose
from rpod_target.population.materials import BARE, FOILS

BodyKind = Literal["box", "hexagon", "octagon", "cylinder", "truss"]
KINDS: tuple[BodyKind, ...] = get_args(BodyKind)
_SIDES = {"hexagon": 6, "octagon": 8}


@dataclass(frozen=True, eq=False)
class MainBody:
    """The body on which everything else is mounted."""

    kind: BodyKind
    components: tuple[Component, ...]
    core: trimesh.Trimesh
    """Solid on whose surface equipment is mounted."""
    length: float
    """Extent of the core along x."""
    radius: float
    """Least distance of the core's lateral surface from the x axis."""
    order: int
    """Order of the symmetry of the core about the x axis."""


def main_body(kind: BodyKind, generator: Generator, *, sections: int, regular: bool) -> MainBody:
    """Return a random body of a kind.

    Args:
        kind: shape of the body; a truss has a box at its end, which is the core.
        generator: random numbers of the satellite.
        sections: number of facets of round parts.
        regular: whether a box must be square across x.
    """
    foil = generator.random() < 0.6
    material = str(generator.choice(FOILS if foil else BARE))
    aspect = float(generator.uniform(0.35, 1.0))
    if kind == "truss":
        return _truss(generator, material, sections=sections)
    if kind == "box":
        sides = aspect * np.array([1.0, 1.0 if regular else generator.uniform(0.5, 0.95)])
        mesh = trimesh.creation.box(extents=(1.0, *sides))
        radius, order = 0.5 * float(sides.min()), 4 if regular else 2
    else:
        order = _SIDES.get(kind, sections)
        around = 0.5 * aspect
        mesh = along_x(trimesh.creation.cylinder(radius=around, height=1.0, sections=order))
        radius = around * float(np.cos(np.pi / order))
    return MainBody(kind, (Component("body", mesh, material),), mesh, 1.0, radius, order)


def _truss(generator: Generator, material: str, *, sections: int) -> MainBody:
    """Return a square truss along x with a box at its end."""
    bays = int(generator.integers(4, 11))
    width = float(generator.uniform(0.6, 1.4)) / bays
    core_length = float(generator.uniform(0.12, 0.3))
    around = width * float(generator.uniform(0.6, 1.6))
    core = trimesh.creation.box(
        extents=(core_length, 2.0 * around, 2.0 * around * float(generator.uniform(0.6, 0.9)))
    )
    lattice = _lattice(bays, width, begin=0.45 * core_length, sections=max(6, sections // 4))
    frame = Component("truss", lattice, str(generator.choice(("aluminium", "white-paint", "black-paint"))))
    return MainBody(
        "truss",
        (Component("body", core, material), frame),
        core,
        core_length,
        0.5 * float(core.extents[1:].min()),
        order=2,
    )


def _lattice(bays: int, width: float, *, begin: float, sections: int) -> trimesh.Trimesh:
    """Return longerons, battens and diagonals of a truss of cubic bays along -x."""
    half, radius = 0.5 * width, 0.03 * width
    length = bays * width
    corners = half * np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)], float)

    def node(bay: int, corner: int) -> FloatArray:
        return np.array((-begin - bay * width, *corners[corner % 4]))

    bars = [bar(node(0, corner), node(bays, corner), radius, sections) for corner in range(4)]
    for bay in range(bays + 1):
        bars += [bar(node(bay, corner), node(bay, corner + 1), 0.8 * radius, sections) for corner in range(4)]
    for bay in range(bays):
        bars += [
            bar(node(bay, corner), node(bay + 1, corner + 1), 0.7 * radius, sections) for corner in range(4)
        ]
    plate = trimesh.creation.box(extents=(0.2 * width, 1.1 * width, 1.1 * width))
    return joined(*bars, placed(plate, pose((-begin - length, 0.0, 0.0))))
