"""Rotations that map the main faces of a target onto each other, whatever their positions.

A satellite is often a box or a prism with smaller parts. Only these parts distinguish attitudes in which the
body looks the same. The whole target has no near-symmetry, since the parts displace the centre of its area or
break the symmetry. If a frame hardly shows the parts, poses that differ by such a rotation are confused.

The faces are compared by their normals and areas alone, as in an extended Gaussian image (B. K. P. Horn,
Proceedings of the IEEE 72, 1984), which does not depend on positions. Faces with opposite normals count as
one direction.
"""

from itertools import permutations, product

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from rpod_pose.search.attitude_grid import even_directions
from rpod_schemas.arrays import FloatArray
from rpod_target import Target
from rpod_target.mesh.topology import areas_m2

CELLS = 2000
"""Number of directions to which the areas of all faces are assigned. Numerics: they are 4 deg apart."""
SAME = np.cos(np.deg2rad(6.0))
"""Least cosine of the angle between two directions that count as one. Numerics: 6 deg is one and a half times
the spacing of the directions."""
APART = np.cos(np.deg2rad(20.0))
"""Cosine of the least angle between two directions that determine a rotation. Numerics: with a smaller angle,
an error of 6 deg causes a rotation error of more than 17 deg."""
TURNED = 0.1
"""Largest difference of the cosines of two pairs of directions that a rotation maps onto each other.
Numerics: 6 deg if they are orthogonal."""
MAIN, ALL = 8, 24
"""Number of directions with the largest areas that are mapped onto each other, and number that is compared
afterwards. Numerics: budgets; a prism of twelve sides has seven."""
MOST = 24
"""Largest number of rotations in the result. Numerics: a budget; a cube has as many, with the identity."""


def face_turns(target: Target) -> list[Rotation]:
    """Return the rotations after which most of a target's area has the same normals, the best ones first.

    The identity and exact symmetries may be among them.
    """
    directions, areas = main_directions(target)
    apart = np.flatnonzero(np.abs(directions @ directions[0]) < APART)
    if not apart.size:
        return []
    pair = directions[[0, apart[0]]]
    found: list[tuple[float, Rotation]] = []
    for one, other in permutations(directions[:MAIN], 2):
        for signs in product((1.0, -1.0), repeat=2):
            onto = np.stack((signs[0] * one, signs[1] * other))
            if abs(pair[0] @ pair[1] - onto[0] @ onto[1]) < TURNED:
                turn, _ = Rotation.align_vectors(onto, pair)
                found.append((_alike(turn, directions, areas), turn))
    found.sort(key=lambda each: -each[0])
    return [turn for _, turn in found[:MOST]]


def main_directions(target: Target) -> tuple[FloatArray, FloatArray]:
    """Return the normals with the largest areas, shape (N, 3), and these areas, m2, (N,), largest first."""
    cells = even_directions(CELLS)
    _, cell = KDTree(cells).query(target.normals)
    areas_of = areas_m2(target.triangles_m)
    area = np.bincount(cell, areas_of, minlength=CELLS)
    sums = np.stack([np.bincount(cell, areas_of * n, minlength=CELLS) for n in target.normals.T])
    found: list[FloatArray] = []
    areas: list[float] = []
    while len(found) < ALL and area.max() > 0.0:
        alike = cells @ cells[area.argmax()]
        near = np.abs(alike) > SAME
        direction = (sums[:, near] * np.sign(alike[near])).sum(axis=1)
        found.append(direction / max(np.linalg.norm(direction), 1e-12))
        areas.append(float(area[near].sum()))
        area[near] = 0.0
    return np.array(found), np.array(areas)


def _alike(turn: Rotation, directions: FloatArray, areas: FloatArray) -> float:
    """Return the share of the area whose normals are the same after a rotation."""
    cosines = np.abs(turn.apply(directions) @ directions.T)
    nearest = cosines.argmax(axis=1)
    same = cosines.max(axis=1) > SAME
    return float(np.minimum(areas, areas[nearest])[same].sum() / areas.sum())
