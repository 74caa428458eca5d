"""Frames of sensors that do not support the track yet: they are registered from the tracked pose."""

from collections.abc import Callable
from dataclasses import replace

from rpod_pose.measurement import Measurement
from rpod_pose.navigation.filter import FilterState
from rpod_pose.navigation.frames import as_measured
from rpod_pose.navigation.history import History, apply
from rpod_pose.navigation.pose_measurement import PoseMeasurement
from rpod_pose.navigation.refusals import refused_newcomer
from rpod_pose.navigation.registering import Registrar
from rpod_pose.navigation.sensors.beside import Beside
from rpod_pose.navigation.sensors.joining import Separation, probation, update_separation
from rpod_pose.navigation.sensors.streams import is_supported
from rpod_pose.navigation.state import Cause, NavigatorState, Output
from rpod_pose.ports import Registration
from rpod_schemas.config.estimator import EstimatorSettings
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.types import Mode

TOO_OLD = "older than the filter's history"
"""Reason for which a measurement is not used."""
UNVERIFIED = "offered: another sensor verifies its first pose"
"""Reason for which a frame of another sensor than that of the first pose is not used."""
Accepting = Callable[[NavigatorState, Measurement, Registration], NavigatorState]
"""Returns the state after a frame whose pose is accepted."""


class Newcomers:
    """Registers frames of sensors that are not established, from the tracked pose.

    Such a sensor may not see the target at all. Therefore its frames neither end a track nor start a search,
    which would delay the other sensors.

    Args:
        settings: settings of the estimator.
        registrar: registers frames.
        output: composes the output of a frame.
        accepting: returns the state after a frame whose pose is accepted.
    """

    def __init__(
        self,
        settings: EstimatorSettings,
        registrar: Registrar,
        output: Callable[..., Output],
        accepting: Accepting,
    ) -> None:
        self._config, self._limits = settings.filter, settings.navigator
        self._stale_after_s, self.beside = settings.stale_after_s, Beside(settings)
        self._registrar, self._output, self._accepting = registrar, output, accepting

    def offer(
        self, state: NavigatorState, history: History, event: Measurement
    ) -> tuple[NavigatorState, Output]:
        """Return the state after a newcomer's frame, and its output."""
        if state.mode == Mode.VERIFYING:
            return state, self._output(state, event, reason=UNVERIFIED, cause=Cause.JOINING)
        separation = state.separation or Separation(history, history)
        predicted = separation.including.at(event.stamp_ns, self._config)
        if predicted is None:
            return state, self._output(state, event, reason=TOO_OLD)
        return self._compared(state, separation, predicted, event)

    def _compared(
        self, state: NavigatorState, separation: Separation, predicted: FilterState, event: Measurement
    ) -> tuple[NavigatorState, Output]:
        registration, reason = self._registrar.register(
            state.joints, event, predicted, tracked=separation.joined
        )
        if reason:
            return state, self._output(state, event, registration, reason=reason)
        since_s = separation.including.since_s(event.stamp_ns, event.sensor)  # on probation too
        measured = replace(as_measured(registration, event), since_s=since_s)
        measured = self.beside.newcomer(measured, predicted)
        grown, nis, accepted = apply(separation.including, measured, self._config, predicted)
        beside = None
        if not (accepted and separation.joined):
            track = apply(separation.published, measured, self._config).history
            beside = track.applied_at(event.stamp_ns, event.sensor)
        if not accepted:
            state = state if separation.joined else replace(state, separation=None)
            reason = refused_newcomer(separation.including, predicted, measured, nis, self._config)
            output = self._output(state, event, registration, reason=reason, nis=nis)
            return state, replace(output, compared=beside)
        if self._are_silent(state, event):
            alone = state.established | {event.sensor}
            state = replace(state, established=alone, separation=None, history=grown)
        else:
            state = replace(state, separation=replace(separation, including=grown))
            if not separation.joined:
                output = self._output(
                    state,
                    event,
                    registration,
                    reason=probation(state.established),
                    cause=Cause.JOINING,
                    nis=nis,
                )
                return state, replace(output, compared=beside)
            state = replace(state, history=grown)
        state = self._accepting(state, event, registration)
        return state, self._output(state, event, registration, nis=nis)

    def _are_silent(self, state: NavigatorState, event: Measurement) -> bool:
        """Return whether no established sensor supports the track any more."""
        streams = {name: state.streams[name] for name in state.established if name in state.streams}
        return not is_supported(
            streams,
            event.stamp_ns,
            at_least_s=self._stale_after_s,
            unknown_s=self._limits.silence_timeout_s,
        )


def applied(
    state: NavigatorState,
    history: History,
    measured: PoseMeasurement,
    config: FilterConfig,
    predicted: FilterState | None = None,
) -> tuple[NavigatorState, float, bool]:
    """Return the state after a pose of an established sensor, its NIS, and whether the gate accepts it.

    A refused pose stays in the history: an older measurement that arrives later may make it consistent.
    ``predicted`` is the history's prediction to the pose's stamp, if the caller has it already.
    """
    separation = state.separation
    if separation is None:
        update = apply(history, measured, config, predicted)
    else:
        update, separation = update_separation(separation, measured, config)
    return replace(state, history=update.history, separation=separation), update.nis, update.accepted
