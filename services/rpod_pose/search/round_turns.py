"""Turns of a nearly round target about its axis.

A drum with antennas, or a spent stage with fittings, has no symmetry: its small parts break it. If a frame
shows few of them, it fits at several turns about the axis, at any angle. The rotations that map main faces
onto each other (``face_turns``) are few of these, since each side of a round body is a direction of its own.

A surface belongs to a body of revolution if the lines along its normals meet the axis. The axis is found by
this: its direction is one in which much of the surface looks, or in which least of it looks, and its place is
where most of the normals' lines meet it.
"""

from math import radians, sin
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from rpod_pose.search.face_turns import MAIN, main_directions
from rpod_schemas.arrays import FloatArray
from rpod_target import Target
from rpod_target.mesh.topology import areas_m2

STEP_DEG = 6.0
"""Angle between neighbouring turns. Numerics: below that at which two poses of a search count as one."""
END = sin(radians(15.0))
"""Least sine of the angle between axis and normal of a side. Numerics: the normals of the ends' faces are
nearly parallel to the axis, and tell no place of it."""
OFF = 0.1
"""Largest distance of a normal's line from the axis, over that of the face. Physics: half of a third of the
sides of a prism of twelve sides, which counts as round; a triangle's centre is that far from their middle."""
ROUND = 0.5
"""Least share of the sides' area that is round. Round area without as much on the other side of the axis does
not count. Physics: most of the target then looks the same after any turn about the axis."""
ROUNDS = 20
"""Number of steps in which the place of the axis is found. Numerics: it then moves by less than 1 % of the
radius."""


class RoundTurns(NamedTuple):
    """Turns about the axis of a nearly round target."""

    turns: FloatArray
    """Rotations by multiples of ``STEP_DEG``, in this order and without the identity, shape (N, 3, 3)."""
    centre_m: FloatArray
    """A point of the axis, target axes, shape (3,), m."""

    @classmethod
    def none(cls) -> "RoundTurns":
        """Return no turns: the target is not round."""
        return cls(np.zeros((0, 3, 3)), np.zeros(3))


def round_turns(target: Target) -> RoundTurns:
    """Return the turns about the axis around which most of a target's sides are round; none without one."""
    places_m, normals = target.triangles_m.mean(axis=1), np.asarray(target.normals, np.float64)
    areas = areas_m2(target.triangles_m)
    directions, _ = main_directions(target)
    _, principal = np.linalg.eigh((areas * normals.T) @ normals)
    best, share = RoundTurns.none(), ROUND
    for axis in (*directions[:MAIN], *principal.T):
        centre_m, found = _roundness(axis, places_m, normals, areas)
        if found > share:
            angles = np.deg2rad(np.arange(STEP_DEG, 360.0, STEP_DEG))
            best = RoundTurns(Rotation.from_rotvec(angles[:, None] * axis).as_matrix(), centre_m)
            share = found
    return best


def _roundness(
    axis: FloatArray, places_m: FloatArray, normals: FloatArray, areas: FloatArray
) -> tuple[FloatArray, float]:
    """Return the place of an axis and the share of the sides' area that is round about it.

    Args:
        axis: direction, shape (3,).
        places_m: centres of the faces, shape (T, 3), m.
        normals: their normals, shape (T, 3).
        areas: their areas, m2, shape (T,).
    """
    across = np.cross(axis, normals)
    sines = np.linalg.norm(across, axis=1)
    sides = (sines > END) & (areas > 0.0)
    if not sides.any():
        return np.zeros(3), 0.0
    across, area, place_m = across[sides] / sines[sides, None], areas[sides], places_m[sides]
    wanted_m = np.einsum("ij,ij->i", across, place_m)
    centre_m = np.average(place_m, axis=0, weights=area)
    least_m = OFF * float(np.linalg.norm(np.ptp(place_m, axis=0))) / ROUNDS
    for _ in range(ROUNDS):  # the sum of absolute distances, so that single parts count little
        weights = area / np.maximum(np.abs(wanted_m - across @ centre_m), least_m)
        system = (weights * across.T) @ across + weights.sum() * np.outer(axis, axis)
        along = weights.sum() * axis * (axis @ centre_m)
        centre_m, *_ = np.linalg.lstsq(system, across.T @ (weights * wanted_m) + along)
    off_m = np.abs(wanted_m - across @ centre_m)
    aside_m = np.cross(place_m - centre_m, axis)
    from_axis_m = np.linalg.norm(aside_m, axis=1)
    found = np.flatnonzero((off_m <= OFF * from_axis_m) & (from_axis_m > 0.0))
    outward = (area[found] / from_axis_m[found]) @ aside_m[found]
    return centre_m, float((area[found].sum() - np.linalg.norm(outward)) / area.sum())
