"""A target that accelerates by more than the filter expects: which accelerations explain a refused pose.

The filter's process noise is that of white accelerations with the configured densities. A pose that the gate
refuses although its frame alone proves it means that the densities were too small for the time since the last
measurement. They are multiplied by the least factors with which the innovation is as large as expected. The
factors are halved at each accepted measurement after that, and raised again where its innovation is larger
than expected (adjustable level of process noise: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with
Applications to Tracking and Navigation, 2001, section 11.2). At most, the twist becomes as uncertain in the
step as where a track begins, or as the accelerations of a mission make it since they began. A pose that even
this does not explain is wrong, or moves by more than the mission allows.
"""

from dataclasses import replace
from math import inf, isfinite, radians, sqrt
from typing import NamedTuple

import numpy as np

from rpod_pose.navigation.filter import (
    ATTITUDE,
    CALM,
    POSE,
    POSITION,
    FilterState,
    Manoeuvre,
    Update,
    predict,
)
from rpod_pose.navigation.pose_measurement import PoseMeasurement, compared
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.messages import NANOSECONDS

_EXPECTED = 3.0
"""Mean of the normalised innovation squared of a position or an attitude. Physics: its degrees of freedom."""
MOST_M_S2, MOST_DEG_S2 = 3.0, 60.0
"""Accelerations that a mission may have, m/s2 and deg/s2. Physics: those of a robot that shakes a mock-up."""
UNNOTICED_S = 0.2
"""Time in which such an acceleration may act before the gate refuses a pose, s. Physics: it moves the target
by 60 mm and turns it by 1.2 deg, which is about what the gate lets pass."""
_STEPS = 1.25 ** np.arange(100.0)
"""Factors that are tried, up to 4e9. Numerics: a quarter more variance each is 12 % of a standard
deviation."""


class _Grown(NamedTuple):
    """Covariance that larger accelerations add to an innovation, for each unit of the factors."""

    by_acceleration: FloatArray
    by_angular: FloatArray


def is_expected(found: Update, predicted: FilterState) -> bool:
    """Return whether a measured pose gives no evidence of larger accelerations than a prediction assumes.

    The gate decides where a manoeuvre begins. While one lasts, poses are compared with the mean instead: the
    factors follow the target at once, since a lag within the gate grows from frame to frame.
    """
    if not isfinite(found.nis):
        return True
    return found.accepted and (predicted.manoeuvre == CALM or found.nis <= predicted.alike.dof)


def explaining(
    before: FilterState, predicted: FilterState, measured: PoseMeasurement, config: FilterConfig
) -> Manoeuvre | None:
    """Return the least factors that explain a refused pose within the bound; None if none do.

    Args:
        before: the state from which the pose was predicted.
        predicted: the prediction.
        measured: the pose.
        config: the filter's configuration.
    """
    step_s = (predicted.stamp_ns - before.stamp_ns) / NANOSECONDS
    if step_s <= 0.0:
        return None
    least = needed(before, predicted, measured, config)
    each_axis_s = max(step_s, UNNOTICED_S) / sqrt(3.0)
    most_m_s = min(config.initial_velocity_sigma_m_s, MOST_M_S2 * each_axis_s)
    most_rad_s = radians(min(config.initial_rate_sigma_deg_s, MOST_DEG_S2 * each_axis_s))
    bound = Manoeuvre(
        most_m_s**2 / (config.acceleration_density_m2_s3 * step_s),
        most_rad_s**2 / (config.angular_acceleration_density_rad2_s3 * step_s),
    )
    found = Manoeuvre(*(max(1.0, min(factor, most)) for factor, most in zip(least, bound, strict=True)))
    return None if found == before.manoeuvre else found


def needed(
    before: FilterState, predicted: FilterState, measured: PoseMeasurement, config: FilterConfig
) -> Manoeuvre:
    """Return the least factors with which an innovation is as large as expected, without a bound.

    The target's rotation counts first, since it moves the origin too. Arguments as for ``explaining``.
    """
    found = compared(predicted, measured, config)
    grown = _grown(before, predicted, config)
    S, acceleration, angular = found.covariance, *before.manoeuvre
    by_angular = _least(found.difference, S, grown.by_angular, ATTITUDE)
    S = S + (by_angular - 1.0) * grown.by_angular
    by_acceleration = _least(found.difference, S, grown.by_acceleration, POSITION)
    return Manoeuvre(acceleration * by_acceleration, angular * by_angular)


def calmed(state: FilterState) -> FilterState:
    """Return a state after an accepted measurement: the factors are halved, to 1 at least."""
    if state.manoeuvre == CALM:
        return state
    return replace(state, manoeuvre=Manoeuvre(*(max(1.0, 0.5 * factor) for factor in state.manoeuvre)))


def _grown(before: FilterState, predicted: FilterState, config: FilterConfig) -> _Grown:
    """Return what a doubling of each factor adds to the covariance of the predicted pose."""
    acceleration, angular = before.manoeuvre

    def added(manoeuvre: Manoeuvre) -> FloatArray:
        moved = predict(replace(before, manoeuvre=manoeuvre), predicted.stamp_ns, config)
        difference: FloatArray = moved.covariance[POSE, POSE] - predicted.covariance[POSE, POSE]
        return difference

    return _Grown(
        added(Manoeuvre(2.0 * acceleration, angular)), added(Manoeuvre(acceleration, 2.0 * angular))
    )


def _least(difference: FloatArray, S: FloatArray, grown: FloatArray, part: slice) -> float:
    """Return the least factor with which a part of an innovation is as large as expected; inf if none is."""
    off = difference[part]
    for factor in _STEPS:
        covariance = (S + (factor - 1.0) * grown)[part, part]
        if float(off @ np.linalg.solve(covariance, off)) <= _EXPECTED:
            return float(factor)
    return inf
