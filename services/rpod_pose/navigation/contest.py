"""Decision about a track after a believed pose that the filter's gate refused."""

from dataclasses import replace

from rpod_pose.navigation.challenger import Outcome, challenge
from rpod_pose.navigation.filter import FilterState
from rpod_pose.navigation.pose_measurement import PoseMeasurement
from rpod_pose.navigation.state import NavigatorState
from rpod_schemas.config.estimator.filter import FilterConfig


def challenged(
    state: NavigatorState,
    predicted: FilterState,
    measured: PoseMeasurement,
    started: FilterState,
    config: FilterConfig,
) -> tuple[NavigatorState, Outcome]:
    """Return the state after a believed pose that the gate refused, and the outcome for the track.

    Args:
        state: state before this pose.
        predicted: the track's prediction to the stamp of the pose.
        measured: the pose.
        started: a filter that starts at the pose.
        config: the filter's configuration.
    """
    challenger, outcome = challenge(
        state.challenger, predicted=predicted, measured=measured, started=started, config=config
    )
    if outcome == Outcome.OPEN:
        return replace(state, challenger=challenger), outcome
    state = replace(state, challenger=None)
    if outcome == Outcome.LOST:
        return state.lost(measured.stamp_ns, seen=True), outcome
    return replace(
        state,
        history=challenger.history,
        separation=None,
    ), outcome
