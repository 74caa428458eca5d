"""Whether two attitudes with angles of the joints show the same surface.

An exact symmetry turns the joints' axes too. If it maps an axis onto itself, the parts look the same at the
same angle; if it reverses the axis, at the opposite angle. So a half turn across the axis of two equal arrays
leaves an attitude with the opposite angle, and not with the same one.
"""

from collections.abc import Mapping
from math import acos, copysign, hypot
from typing import NamedTuple

import numpy as np

from rpod_pose.belief import Angle
from rpod_schemas.arrays import FloatArray
from rpod_target import Equivalence

ALONG = 0.999
"""Least cosine between a joint's axis and a turned one for which they are the same line. Numerics: 2.6 deg;
files round axes."""
SIGMAS = 3.0
"""Difference of two angles, in standard deviations, within which they may be equal. Physics: one in 370
normal errors is larger."""


class State(NamedTuple):
    """An attitude of a target with the angles of its joints."""

    R: FloatArray
    """Rotation from target axes to another frame, shape (3, 3)."""
    angles: Mapping[str, Angle]
    """Angles by name; those with a standard deviation of 0 are compared as they are."""


def are_same(
    one: State, other: State, *, alike: Equivalence, axes: Mapping[str, FloatArray], within_rad: float
) -> bool:
    """Return whether two states are the same modulo the exact symmetries.

    Args:
        one: a state.
        other: another state of the same target, with the same joints.
        alike: attitudes that no measurement distinguishes at the joints' angles 0.
        axes: unit vector along the axis of each joint, target axes, shape (3,), by name.
        within_rad: largest difference of attitudes, and of angles that are known exactly.
    """
    own = Equivalence(np.eye(3)[None], alike.free_axes)
    for turn in alike.turns:
        along = {name: float(axes[name] @ turn @ axes[name]) for name in one.angles}
        if any(abs(cosine) < ALONG for cosine in along.values()):
            continue  # it turns the axis elsewhere, so that it is no symmetry at other angles
        cosine = float(own.cosines((one.R @ turn)[None], other.R[None])[0, 0])
        if acos(min(max(cosine, -1.0), 1.0)) > within_rad:
            continue
        if all(
            abs(copysign(angle.angle_rad, along[name] * angle.angle_rad) - other.angles[name].angle_rad)
            <= max(within_rad, SIGMAS * hypot(angle.sigma_rad, other.angles[name].sigma_rad))
            for name, angle in one.angles.items()
        ):
            return True
    return False
