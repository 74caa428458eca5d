"""A sequence of measurements through the navigator and the integrity monitor, in this process."""

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

from scipy.spatial.transform import RigidTransform

from rpod_campaign.sequences.clocks import ClockCheck
from rpod_estimator.frame_reader import FROZEN_REPEATS
from rpod_pose.measurement import Measurement
from rpod_pose.navigation.dynamics.options import Dynamics
from rpod_pose.navigation.integrity.memory import Memory
from rpod_pose.navigation.integrity.monitor import Monitor
from rpod_pose.navigation.integrity.wrong_streams import CLOCK_MOVED_S
from rpod_pose.navigation.navigator import Navigator
from rpod_pose.navigation.state import NavigatorState, Output
from rpod_pose.ports import Methods
from rpod_schemas.config.estimator import EstimatorSettings
from rpod_schemas.errors import Reason
from rpod_schemas.topics import CHASER
from rpod_schemas.types import EstimatorStatus, Integrity
from rpod_target import Target


class Arrived(NamedTuple):
    """A measurement as the estimator gets it."""

    time_s: float
    measurement: Measurement
    repeats: int = 0
    """Number of measurements in a row, up to this one, that equal the one before. The estimator refuses them
    before the navigator."""
    clock: ClockCheck = ClockCheck()
    """What its stamp and its arrival tell of its clock."""


class Judged(NamedTuple):
    """A measurement, and what the estimator publishes after it."""

    arrived: Arrived
    state: NavigatorState
    output: Output
    integrity: Integrity


def judged(
    settings: EstimatorSettings,
    methods: Mapping[str, Methods],
    model: Target,
    arriving: Iterable[Arrived],
    *,
    T_chaser_target: RigidTransform,
) -> Iterator[Judged]:
    """Yield what the estimator publishes after each measurement.

    Each measurement is asked for after the one before has been judged.

    Args:
        settings: settings of the estimator.
        methods: methods by the sensor's name.
        model: the target's model.
        arriving: the measurements, in their order.
        T_chaser_target: pose at which the navigator starts.
    """
    navigator = Navigator(
        settings,
        methods,
        centre_of_mass_m=model.centre_of_mass_m,
        alike=model.equivalence,
        joints=model.joints,
        dynamics=Dynamics.of(settings.dynamics, model),
    )
    monitor, memory = Monitor(settings), Memory()
    state = navigator.start(T_chaser_target)
    for each in arriving:
        step, moved_s = each.clock.step, each.clock.corrected_s
        if step is not None:
            output, moved_s = (
                _refused(each.measurement, state, f"{Reason.CLOCK_STEP}: {step.text}"),
                step.moved_s,
            )
        elif each.repeats:
            output = _refused(each.measurement, state, Reason.FROZEN)
        else:
            state, output = navigator.step(state, each.measurement)
        output = output.with_evidence(CLOCK_MOVED_S, moved_s) if moved_s else output
        memory, integrity = monitor.assess(memory, state, output, frozen=each.repeats >= FROZEN_REPEATS)
        yield Judged(each, state, output, integrity)


def _refused(measurement: Measurement, state: NavigatorState, reason: str) -> Output:
    status = EstimatorStatus(
        stamp_ns=measurement.stamp_ns,
        frame_id=CHASER,
        mode=state.mode,
        sensor=measurement.sensor,
        reason=reason,
    )
    return Output(status, None)
