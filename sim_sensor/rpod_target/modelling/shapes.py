"""Shapes of equipment: closed surfaces that are given by their dimensions alone.

Lengths have the unit of the arguments. A shape stands along z, or lies as its function says.
"""

from collections.abc import Sequence

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from rpod_schemas.arrays import FloatArray
from rpod_target.modelling.component import bar, joined, placed, pose


def block(size: Sequence[float], centre: Sequence[float] | FloatArray = (0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    """Return a cuboid with these sides about a centre."""
    return placed(trimesh.creation.box(extents=size), pose(centre))


def revolved(profile: ArrayLike, sections: int) -> trimesh.Trimesh:
    """Return the body of revolution of a closed profile of radius and height, shape (P, 2), about z."""
    mesh: trimesh.Trimesh = trimesh.creation.revolve(np.asarray(profile, float), sections=sections)
    if mesh.volume < 0.0:
        mesh.invert()
    return mesh


def tube(
    inner: float, outer: float, height: float, sections: int, *, top: float | None = None
) -> trimesh.Trimesh:
    """Return a tube from z = 0 to its height; ``top`` is the outer radius there of a conical one."""
    top = outer if top is None else top
    wall = outer - inner
    return revolved([(inner, 0.0), (outer, 0.0), (top, height), (top - wall, height), (inner, 0.0)], sections)


def dome(radius: float, height: float, sections: int, *, steps: int = 6) -> trimesh.Trimesh:
    """Return half an ellipsoid of revolution that stands on z = 0."""
    angle = np.linspace(0.0, 0.5 * np.pi, steps + 1)
    arc = np.column_stack((radius * np.cos(angle), height * np.sin(angle)))
    arc[-1, 0] = 0.0
    return revolved([(0.0, 0.0), *arc.tolist()], sections)


def ellipsoid(radius: float, height: float, sections: int, *, steps: int = 10) -> trimesh.Trimesh:
    """Return an ellipsoid of revolution about the origin; ``height`` is its half axis along z."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, steps + 1)
    arc = np.column_stack((radius * np.cos(angle), height * np.sin(angle)))
    arc[[0, -1], 0] = 0.0
    return revolved(arc, sections)


def reflector(radius: float, depth: float, thick: float, sections: int) -> trimesh.Trimesh:
    """Return a parabolic reflector that opens to +z, its vertex at the origin."""
    r = np.linspace(0.0, radius, 9)
    inner = np.column_stack((r, depth * (r / radius) ** 2 + thick))
    outer = np.column_stack((r[::-1], depth * (r[::-1] / radius) ** 2))
    return revolved(np.concatenate((inner, outer)), sections)


def feed_struts(radius: float, depth: float, focus: FloatArray, thick: float) -> list[trimesh.Trimesh]:
    """Return three struts from near the rim of a reflector to its focus."""
    angles = 2.0 * np.pi * np.arange(3) / 3.0
    rim = np.column_stack((0.8 * radius * np.cos(angles), 0.8 * radius * np.sin(angles), np.full(3, depth)))
    return [bar(foot, focus, thick, 6) for foot in rim]


def dish(radius: float, sections: int, stand: FloatArray) -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """Return a parabolic antenna at a pose, and its feed on three struts."""
    depth, focus = 0.3 * radius, np.array((0.0, 0.0, 0.95 * radius))
    feed = placed(
        tube(0.03 * radius, 0.1 * radius, 0.3 * radius, 12), pose(focus - (0.0, 0.0, 0.15 * radius))
    )
    struts = feed_struts(radius, depth, focus, 0.025 * radius)
    return (
        placed(reflector(radius, depth, 0.04 * radius, sections), stand),
        placed(joined(feed, *struts), stand),
    )


def bell(throat: float, exit_radius: float, length: float, sections: int) -> trimesh.Trimesh:
    """Return a bell nozzle from z = 0 down to -length, with a plug of 0.3 of its length above."""
    share = np.linspace(0.0, 1.0, 7)
    wall = throat + (exit_radius - throat) * np.sqrt(share)
    outer = np.column_stack((wall, -length * share))
    inner = np.column_stack((np.maximum(wall - 0.08 * throat, 0.05 * throat), -length * share))[::-1]
    top = [(0.0, 0.3 * length), (throat, 0.3 * length)]
    bottom = [(0.0, -0.1 * length)]
    return revolved(np.concatenate((top, outer, inner[:-1], bottom)), sections)


def panel_row(
    count: int, size: tuple[float, float], gap: float, thick: float, *, begin: float
) -> tuple[list[trimesh.Trimesh], list[trimesh.Trimesh]]:
    """Return the front and back sheets of panels in a row along y, which lie in the plane z = 0.

    Args:
        count: number of panels.
        size: extent of a panel along x and y.
        gap: gap between two panels.
        thick: thickness of both sheets together.
        begin: y at which the first panel begins.
    """
    fronts: list[trimesh.Trimesh] = []
    backs: list[trimesh.Trimesh] = []
    for panel in range(count):
        middle = begin + panel * (size[1] + gap) + 0.5 * size[1]
        for side, sheets in ((1.0, fronts), (-1.0, backs)):
            sheet = trimesh.creation.box(extents=(*size, 0.5 * thick))
            sheets.append(placed(sheet, pose((0.0, middle, 0.25 * side * thick))))
    return fronts, backs


def tiles(
    size: tuple[float, float], counts: tuple[int, int], *, gap: float, thick: float
) -> list[trimesh.Trimesh]:
    """Return tiles that cover a rectangle about the origin in the plane z = 0, on its +z side."""
    steps = [length / count for length, count in zip(size, counts, strict=True)]
    return [
        block(
            (steps[0] - gap, steps[1] - gap, thick),
            ((i + 0.5) * steps[0] - 0.5 * size[0], (j + 0.5) * steps[1] - 0.5 * size[1], 0.5 * thick),
        )
        for i in range(counts[0])
        for j in range(counts[1])
    ]


def frame(size: tuple[float, float], *, wide: float, thick: float) -> trimesh.Trimesh:
    """Return a rectangular frame of four beams about the origin in the plane z = 0."""
    x, y = 0.5 * (size[0] - wide), 0.5 * (size[1] - wide)
    return joined(
        *(block((size[0], wide, thick), (0.0, side * y, 0.0)) for side in (-1.0, 1.0)),
        *(block((wide, size[1] - wide, 0.9 * thick), (side * x, 0.0, 0.0)) for side in (-1.0, 1.0)),
    )
