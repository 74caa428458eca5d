"""What a filter assumes of a motion that no measurement has shown."""

from math import sqrt

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_schemas.config.estimator.filter import FilterConfig

MOST_M_S2 = 3.0
"""Largest acceleration in a mission, m/s2. Physics: that of a robot that shakes a mock-up."""
_SIGMAS = 3.0
"""Standard deviations that cover the largest speed. Physics: one in 370 normal errors is larger."""


def velocity_sigma_m_s(T_chaser_target: RigidTransform, config: FilterConfig) -> float:
    """Return the standard deviation of the velocity of each axis at a pose, if nothing is known of it.

    It is the configured one. Otherwise the chaser is assumed to be able to stop before the target: the
    largest speed is that from which the largest acceleration of a mission stops it over the range.
    """
    if config.initial_velocity_sigma_m_s is not None:
        return config.initial_velocity_sigma_m_s
    range_m = float(np.linalg.norm(T_chaser_target.translation))
    return sqrt(2.0 * MOST_M_S2 * range_m) / _SIGMAS
