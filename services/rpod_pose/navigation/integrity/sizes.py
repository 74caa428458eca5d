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

SizedFilters = Mapping[float, FilterState]
"""Filters by the relative enlargement of the target."""


def sized_after(
    filters: SizedFilters, sizes: tuple[OtherSize, ...], step: Step, config: FilterConfig
) -> SizedFilters:
    """Return the filters after a measurement of the track.

    They use what the track uses, with its densities of accelerations: another decision of the gate would
    shift them too. A filter that is not there yet begins as if all earlier poses had the same shift.

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
            before = replace(track, T_chaser_target=moved(track.T_chaser_target, size.step))
        before = replace(before, manoeuvre=track.manoeuvre, lag=track.lag)
        state = predict(before, measured.stamp_ns, config)
        if step.outcome.accepted:
            pose = moved(measured.T_chaser_target, size.step)
            state = updated(state, replace(measured, T_chaser_target=pose), ungated).state
        found[size.share] = state
    return found


def shifts_of(estimate: FilterState, filters: SizedFilters, config: FilterConfig) -> dict[float, FloatArray]:
    """Return (dp, dtheta) from the estimate to each filter, by the enlargement, shape (6,) each."""
    return {
        share: separation_of(predict(state, estimate.stamp_ns, config), estimate)
        for share, state in filters.items()
        if state.stamp_ns <= estimate.stamp_ns
    }
