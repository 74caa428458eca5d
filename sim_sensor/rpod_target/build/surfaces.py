"""Surfaces of the analytic parts, as triangles that run counter-clockwise seen from outside."""

from dataclasses import dataclass
from itertools import cycle, islice

import numpy as np

from rpod_schemas.arrays import FloatArray
from rpod_target.parameters import (
    BoxParameters,
    CylinderParameters,
    FrustumParameters,
    PrismParameters,
)

FACETS = 32
"""Facets of a cylinder or a cone."""

_BOX_CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_BOX_QUADS = np.array(
    [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
)  # -x, +x, -y, +y, -z, +z


@dataclass(frozen=True, eq=False)
class Surface:
    """The surface of one part."""

    triangles_m: FloatArray
    """Triangles, part axes, shape (T, 3, 3)."""
    materials: tuple[str, ...]
    """Name of each triangle's material, length T."""


def box_surface(part: BoxParameters) -> Surface:
    """Return the surface of a box, part axes."""
    corners = _BOX_CORNERS * part.size_m
    triangles = corners[np.concatenate([_BOX_QUADS[:, [0, 1, 2]], _BOX_QUADS[:, [0, 2, 3]]])]
    return Surface(triangles, (part.material,) * len(triangles))


def prism_surface(part: PrismParameters) -> Surface:
    """Return the surface of a prism, part axes."""
    radius_m = part.circumradius_m

    def materials(names: tuple[str, ...]) -> list[str]:
        return list(islice(cycle(names or (part.material,)), part.sides))

    return Surface(
        _revolved(part.sides, base_radius_m=radius_m, top_radius_m=radius_m, length_m=part.length_m),
        tuple(
            materials(part.base_materials)
            + materials(part.side_materials) * 2
            + materials(part.top_materials)
        ),
    )


def frustum_surface(part: FrustumParameters) -> Surface:
    """Return the surface of a cone, whole or cut off, part axes."""
    triangles = _revolved(
        FACETS, base_radius_m=part.base_radius_m, top_radius_m=part.top_radius_m, length_m=part.length_m
    )
    return Surface(triangles, (part.material,) * len(triangles))


def cylinder_surface(part: CylinderParameters) -> Surface:
    """Return the surface of a cylinder, part axes."""
    triangles = _revolved(
        FACETS, base_radius_m=part.radius_m, top_radius_m=part.radius_m, length_m=part.length_m
    )
    return Surface(triangles, (part.material,) * len(triangles))


def _revolved(sides: int, *, base_radius_m: float, top_radius_m: float, length_m: float) -> FloatArray:
    """Return the sectors of the base, two halves of each lateral face, and the sectors of the top, if any."""
    angle = np.arange(sides) * (2.0 * np.pi / sides)
    ring = np.stack([np.zeros(sides), np.cos(angle), np.sin(angle)], axis=1)
    foot, tip = np.zeros((sides, 3)), np.tile([length_m, 0.0, 0.0], (sides, 1))
    base, top = base_radius_m * ring, top_radius_m * ring + tip
    base_next, top_next = np.roll(base, -1, axis=0), np.roll(top, -1, axis=0)
    blocks = [(foot, base_next, base), (base, base_next, top)]
    if top_radius_m > 0.0:
        blocks += [(base_next, top_next, top), (tip, top, top_next)]
    return np.concatenate([np.stack(block, axis=1) for block in blocks])
