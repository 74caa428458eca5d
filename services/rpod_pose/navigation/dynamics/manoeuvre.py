"""Adaptation of the process noise to a target that accelerates more than the filter expects.

The filter's process noise is that of white accelerations with the configured densities. There are two signs
that the densities are too small for a motion: the gate refuses a pose although its frame alone proves it, or
successive innovations of accepted poses have the same direction (``followed``). Then the densities are
multiplied by factors (adjustable level of process noise: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation
with Applications to Tracking and Navigation, 2001, section 11.2).

For a refused pose the factors are the smallest ones with which the innovation is as large as expected. While
they are above 1, they are raised again if an innovation is larger than expected. The factors have an upper
bound: the twist may not become more uncertain in a step than at the beginning of a track, and not more than
the largest accelerations of a mission can make it. A pose that even this does not explain is wrong, or the
target moves more than the mission allows.
"""

from dataclasses import replace
from math import exp, inf, isfinite, radians, sqrt
from typing import NamedTuple

import numpy as np

from rpod_pose.navigation.filter import (
    ATTITUDE,
    CALM,
    MOST_M_S2,
    NO_INNOVATIONS,
    POSE,
    POSITION,
    FilterState,
    Innovation,
    InnovationSum,
    Manoeuvre,
    Update,
    gate_of,
    predict,
    velocity_sigma_m_s,
)
from rpod_pose.navigation.pose_measurement import PoseMeasurement, compared
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.messages import NANOSECONDS

_EXPECTED = 3.0
"""Mean of the normalised innovation squared of a position or an attitude. Physics: its degrees of freedom."""
MOST_DEG_S2 = 60.0
"""Largest angular acceleration in a mission, deg/s2. Physics: that of a robot that shakes a mock-up."""
UNNOTICED_S = 0.2
"""Time for which such an acceleration may act before the gate refuses a pose, s. Physics: it moves the target
by 60 mm and turns it by 1.2 deg, which is about what the gate accepts."""
LAG_S = 1.0
"""Time in which the weight of an innovation falls to 1/e, s. Physics: a robot or a tumbling body accelerates
in one direction for about a second or longer; the gate detects shorter pushes."""
_SHORTEST_S = 1e-9
"""Least time between two measurements, s. Numerics: stamps are whole nanoseconds."""
_STEPS = 1.25 ** np.arange(100.0)
"""Factors that are tried, up to 4e9. Numerics: each has a quarter more variance, so the standard deviation
grows by 12 %."""


class _Grown(NamedTuple):
    """Covariance that larger accelerations add to an innovation when a factor is doubled, shape (6, 6)."""

    by_acceleration: FloatArray
    by_angular: FloatArray


def is_expected(found: Update, predicted: FilterState) -> bool:
    """Return whether a measured pose gives no evidence of larger accelerations than a prediction assumes.

    The gate decides when a manoeuvre begins. During a manoeuvre the NIS is compared with its mean instead.
    So the factors follow the target at once: a lag within the gate would grow from frame to frame.
    """
    if not isfinite(found.nis):
        return True
    return found.accepted and (predicted.manoeuvre == CALM or found.nis <= predicted.alike.dof)


def explaining(
    before: FilterState, predicted: FilterState, measured: PoseMeasurement, config: FilterConfig
) -> Manoeuvre | None:
    """Return the least factors that explain a refused pose, within the bound; None if they do not change.

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
    bound = greatest(step_s, before, config)
    found = Manoeuvre(*(max(1.0, min(factor, most)) for factor, most in zip(least, bound, strict=True)))
    return None if found == before.factors else found


def needed(
    before: FilterState, predicted: FilterState, measured: PoseMeasurement, config: FilterConfig
) -> Manoeuvre:
    """Return the least factors with which an innovation is as large as expected, without a bound.

    The factor of the rotation is determined first, since a rotation also moves the origin. Arguments as for
    ``explaining``.
    """
    found = compared(predicted, measured, config)
    grown = _grown(before, predicted, config)
    S, acceleration, angular = found.covariance, *before.factors
    by_angular = _least(found.difference, S, grown.by_angular, ATTITUDE)
    S = S + (min(by_angular, float(_STEPS[-1])) - 1.0) * grown.by_angular
    by_acceleration = _least(found.difference, S, grown.by_acceleration, POSITION)
    return Manoeuvre(acceleration * by_acceleration, angular * by_angular)


def followed(
    before: FilterState,
    predicted: FilterState,
    found: Update,
    measured: PoseMeasurement,
    config: FilterConfig,
) -> FilterState:
    """Return the state after an accepted pose, with the factors that follow from it.

    The factors of an earlier refused pose are halved.

    The innovations of a filter without a lag are independent of each other. If their weighted sum is beyond
    the gate, the estimate lags behind the target, although each pose is within the gate. Then the factor of
    the lag is multiplied by the sum's normalised square over the expected one, and a new sum begins.
    Otherwise this factor decreases to 1: it is halved at each pose, too, but its logarithm falls to about 1/e
    in ``LAG_S`` at the fastest.

    Args:
        before: the state after the previous measurement.
        predicted: the prediction that the pose met.
        found: the update.
        measured: the pose; if its frame alone does not prove it, it raises no factor.
        config: the filter's configuration.
    """
    state = found.state
    step_s = max((state.stamp_ns - before.stamp_ns) / NANOSECONDS, _SHORTEST_S)
    keep, bound = exp(-step_s / LAG_S), greatest(step_s, before, config)
    state = replace(
        state,
        manoeuvre=Manoeuvre(*(max(1.0, 0.5 * factor) for factor in state.manoeuvre)),
        lag=Manoeuvre(*(max(1.0, 0.5 * factor, keep * factor**keep) for factor in state.lag)),
    )
    sums, factors = [each.faded(keep) for each in state.sums], list(state.lag)
    if not measured.alone:
        return replace(state, sums=(sums[0], sums[1]))
    for index, part in enumerate((POSITION, ATTITUDE)):
        sums[index] = _added(predicted.sums[index].faded(keep), sums[index], found.innovation, part)
        if excess := _excess(sums[index], config):
            sums[index] = NO_INNOVATIONS
            if before.may_be_raised[index]:
                factors[index] = max(1.0, min(before.factors[index] * excess, bound[index]))
    return replace(state, sums=(sums[0], sums[1]), lag=Manoeuvre(*factors))


def _added(met: InnovationSum, left: InnovationSum, innovation: Innovation, part: slice) -> InnovationSum:
    """Return a sum with the innovation of one more pose.

    A filter that only considers errors that last does not leave its innovations independent: each shares
    with the errors that are left, and these come back in the next ones.

    Args:
        met: the sum at the prediction that the pose met.
        left: the same after the update.
        innovation: that of the pose.
        part: position or attitude.
    """
    off, covariance = innovation.difference[part], innovation.covariance[part, part]
    summed, shared = met.covariance + covariance, left.shared
    if met.shared is not None:  # the innovation is noise less H times the errors
        with_it = met.shared_with(innovation.H.shape[1]) @ innovation.H[part].T
        summed = summed - with_it - with_it.T
    if innovation.left is not None:
        shared = left.shared_with(innovation.left.shape[1]) + innovation.left[part]
    return InnovationSum(
        met.difference + off,
        summed,
        met.squares + _square(off, covariance),
        met.weights + 1.0,
        met.squared_weights + 1.0,
        shared,
    )


def _excess(found: InnovationSum, config: FilterConfig) -> float:
    """Return the normalised square of a sum over the expected one; 0 if it is within the gate.

    Poses that are noisier than they state do not count as a lag: where the innovations' own squares are
    larger than expected, so may be the sum's.
    """
    noisier = max(1.0, found.squares / (_EXPECTED * found.squared_weights))
    square = _square(found.difference, noisier * found.covariance)
    return square / _EXPECTED if square > gate_of(config, 3) else 0.0


def _square(difference: FloatArray, covariance: FloatArray) -> float:
    """Return the normalised square of a part of an innovation, or of a sum of them."""
    return float(difference @ np.linalg.solve(covariance, difference))


def greatest(step_s: float, before: FilterState, config: FilterConfig) -> Manoeuvre:
    """Return the greatest factors in a step, s, with which the twist is as uncertain as a mission allows.

    Args:
        step_s: duration of the step.
        before: the state at its beginning; the speed that a mission allows depends on the range.
        config: the filter's configuration.
    """
    each_axis_s = max(step_s, UNNOTICED_S) / sqrt(3.0)
    most_m_s = min(velocity_sigma_m_s(before.T_chaser_target, config), MOST_M_S2 * each_axis_s)
    most_rad_s = radians(min(config.initial_rate_sigma_deg_s, MOST_DEG_S2 * each_axis_s))
    return Manoeuvre(
        most_m_s**2 / (config.acceleration_density_m2_s3 * step_s),
        most_rad_s**2 / (config.angular_acceleration_density_rad2_s3 * step_s),
    )


def _grown(before: FilterState, predicted: FilterState, config: FilterConfig) -> _Grown:
    """Return the covariance that a doubling of each factor adds to that of the predicted pose."""
    acceleration, angular = before.factors

    def added(manoeuvre: Manoeuvre) -> FloatArray:
        moved = predict(replace(before, manoeuvre=manoeuvre), predicted.stamp_ns, config)
        difference: FloatArray = moved.covariance[POSE, POSE] - predicted.covariance[POSE, POSE]
        return difference

    return _Grown(
        added(Manoeuvre(2.0 * acceleration, angular)), added(Manoeuvre(acceleration, 2.0 * angular))
    )


def _least(difference: FloatArray, S: FloatArray, grown: FloatArray, part: slice) -> float:
    """Return the least factor with which a part of an innovation is as large as expected; inf if none is.

    It is 1 where the model of motion states its own noise, which no factor raises.
    """
    off = difference[part]
    if not grown[part, part].any():
        return 1.0
    for factor in _STEPS:
        if _square(off, (S + (factor - 1.0) * grown)[part, part]) <= _EXPECTED:
            return float(factor)
    return inf
