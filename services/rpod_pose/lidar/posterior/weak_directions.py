"""Motions of a pose that the returns on faces determine least.

A plate slides in its plane, and a part of a body of revolution turns about its axis: the returns stay on the
faces, and the outline alone determines the place. The likelihood then has several optima along this motion,
which may be many degrees apart. An alignment ends at one of them, and its information is that of one optimum.
"""

from collections.abc import Callable
from math import pi

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_schemas.arrays import FloatArray

MOTIONS = 3
"""Number of motions that are followed. Physics: a plane leaves three of them open."""
MOST = 12
"""Largest number of steps to each side. Numerics: a budget of computation."""


def weakest_motions(information: FloatArray, radius_m: float) -> FloatArray:
    """Return the motions (dtau, dtheta) that an information matrix determines least, shape (MOTIONS, 6).

    Their length is 1 m, for turns that of the farthest point.

    Args:
        information: information matrix of (dtau, dtheta) by the returns on faces alone, shape (6, 6).
        radius_m: distance of the target's farthest point from its origin.
    """
    unit = np.repeat((1.0, 1.0 / radius_m), 3)
    _, motions = np.linalg.eigh(unit[:, None] * information * unit)
    found: FloatArray = (motions[:, :MOTIONS] * unit[:, None]).T
    return found


def walked(
    motion: FloatArray, spacing_m: float, radius_m: float, is_likely: Callable[[FloatArray], bool]
) -> list[FloatArray]:
    """Return steps (dtau, dtheta) to both sides along a motion, as far as the poses there are likely.

    The motion is a screw with a constant axis, so that a body of revolution stays on itself. It ends at half
    a turn, or where the target has moved by its own size.

    Args:
        motion: one of the ``weakest_motions``, shape (6,).
        spacing_m: length of a step, m: the distance of neighbouring rays at the target.
        radius_m: as for ``weakest_motions``.
        is_likely: function that returns whether the pose after a step is likely.
    """
    turn, shift = float(np.linalg.norm(motion[3:])), float(np.linalg.norm(motion[:3]))
    most = min(MOST, int(1.0 / max(turn / pi, shift / (2.0 * radius_m)) / spacing_m))
    found = []
    for side in (-1.0, 1.0):
        for number in range(1, most + 1):
            screw = RigidTransform.from_exp_coords(side * number * spacing_m * np.roll(motion, 3))
            step = np.concatenate((screw.translation, screw.rotation.as_rotvec()))
            if not is_likely(step):
                break
            found.append(step)
    return found
