"""Filters of the poses that a sensor would measure if the target were larger or smaller than its model.

An error of the size shifts all poses of a view alike, and the estimate follows them. So the estimate's shift
is that of a filter whose measurements are the shifted poses. The newest frame's shift may be smaller, where
the target shows another side than in the frames before.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from rpod_pose.navigation.filter import FilterState, predict, separation_of
from rpod_pose.navigation.history import Step
from rpod_pose.navigation.pose_measurement import updated
from rpod_pose.pose_evidence import OtherSize
from rpod_pose.registration.lie_group import moved
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.filter import FilterConfig

JUMPED_SIGMAS = 30.0
"""Difference of two rates that are those of different motions, in standard deviations. Numerics: rates of
filters at a wrong size stay within 18 of the track's (560 frames), those that did not follow a jump have 65
or more."""

SizedFilters = Mapping[float, FilterState]
"""Filters by the relative enlargement of the target."""


def sized_after(
    filters: SizedFilters, sizes: tuple[OtherSize, ...], step: Step, config: FilterConfig
) -> SizedFilters:
    """Return the filters after a measurement of the track.

    They use what the track uses, with its densities of accelerations: another decision of the gate would
    shift them too. A filter that is not there yet begins as if all earlier poses had the same shift. So does
    one whose rate leaves that of the track, since a target of another size turns as fast: it did not follow
    a jump of the track, and would end at a motion that no body has.

    Args:
        filters: the filters before.
        sizes: poses of the newest frame that has some.
        step: the measurement, and what the track made of it.
        config: configuration of the filter.
    """
    tuning = config.tuning.model_copy(update={"gate_nis": np.inf})
    ungated = config.model_copy(update={"tuning": tuning})
    measured, track = step.measurement, step.predicted
    found = {}
    for size in sizes:
        before = filters.get(size.share)
        if before is None or before.stamp_ns > measured.stamp_ns:
            before = _enlarged(track, size)
        before = replace(before, manoeuvre=track.manoeuvre, lag=track.lag)
        state = predict(before, measured.stamp_ns, config)
        if step.outcome.accepted:
            pose = moved(measured.T_chaser_target, size.step)
            state = updated(state, replace(measured, T_chaser_target=pose), ungated).state
        jumped = not _turns_like(state, step.outcome.state)
        found[size.share] = _enlarged(step.outcome.state, size) if jumped else state
    return found


def _enlarged(track: FilterState, size: OtherSize) -> FilterState:
    """Return the filter at another size if all poses had the shift of the newest one."""
    return replace(track, T_chaser_target=moved(track.T_chaser_target, size.step))


def _turns_like(state: FilterState, track: FilterState) -> bool:
    """Return whether a filter's rate is that of the track, within ``JUMPED_SIGMAS``."""
    apart = state.rate_rad_s - track.rate_rad_s
    return bool(apart @ np.linalg.solve(state.covariance[9:12, 9:12], apart) < JUMPED_SIGMAS**2)


def shifts_of(estimate: FilterState, filters: SizedFilters, config: FilterConfig) -> dict[float, FloatArray]:
    """Return (dp, dtheta) from the estimate to each filter, by the enlargement, shape (6,) each."""
    return {
        share: separation_of(predict(state, estimate.stamp_ns, config), estimate)
        for share, state in filters.items()
        if state.stamp_ns <= estimate.stamp_ns
    }
