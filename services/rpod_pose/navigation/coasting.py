"""Coasting: a track without measurements is predicted, and is lost when its covariance exceeds a limit.

The limit is the alert limit of the sensor whose frame the track accepted last. Below it, the prediction is as
good as the mission requires of an estimate. A time-out would not ensure this. A track with measurements
continues beyond the limit, but its estimates are published as not valid.
"""

from dataclasses import replace
from math import degrees

import numpy as np

from rpod_pose.belief import MOST_SIGMA_DEG, worst_sigma
from rpod_pose.navigation.dynamics.slewing import doubts, told
from rpod_pose.navigation.filter import POSE, UNSEEN, FilterState, predict
from rpod_pose.navigation.sensors.streams import is_supported, supported_ns, supporters, unsupported_s
from rpod_pose.navigation.state import NavigatorState, Output
from rpod_pose.ports import Registration
from rpod_schemas.config.estimator import EstimatorSettings
from rpod_schemas.config.sensor import AlertLimit
from rpod_schemas.poses import rotation_matrix
from rpod_schemas.types import Mode


class Coasting:
    """Decides when a track coasts, when it is lost, and whether its estimates are usable.

    Args:
        settings: settings of the estimator.
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        self._config, self._limits = settings.filter, settings.navigator
        self._stale_after_s = settings.stale_after_s
        self._alerts = {sensor.name: sensor.alert_limit for sensor in settings.sensors}

    def aged(self, state: NavigatorState, stamp_ns: int) -> tuple[NavigatorState, str]:
        """Return the state at a stamp before a new measurement is applied, and the reason if it changes."""
        if not state.mode.has_track or state.history is None or self._is_supported(state, stamp_ns):
            return state, ""
        silent = f"no measurement was accepted for {unsupported_s(state.streams, stamp_ns):.2f} s"
        newest = state.history.state
        if doubted := told(doubts(newest)):
            silent += f", and {doubted}"
        if beyond := self._beyond(state, predict(newest, max(stamp_ns, newest.stamp_ns), self._config)):
            return state.lost(stamp_ns, left=newest), f"{silent}, {beyond}"
        if state.mode == Mode.COASTING:
            return state, ""
        return replace(state, mode=Mode.COASTING, unseen_ns=supported_ns(state.streams)), silent

    def mode_after(self, state: NavigatorState, registration: Registration, stamp_ns: int) -> Mode:
        """Return the mode of a track that has accepted a frame.

        A frame may leave a direction of the pose open, as of a face that fills the image. There the track is
        predicted as without a frame. When its covariance has passed the alert limit, the track coasts until
        frames bring the covariance back. It is not lost as long as frames support it elsewhere.
        """
        if not self.unusable(state, stamp_ns):
            return Mode.TRACKING
        coasts = state.mode == Mode.COASTING or _leaves_open(state, registration)
        return Mode.COASTING if coasts else Mode.TRACKING

    def _is_supported(self, state: NavigatorState, stamp_ns: int) -> bool:
        return is_supported(
            state.streams,
            stamp_ns,
            at_least_s=self._stale_after_s,
            unknown_s=self._limits.silence_timeout_s,
        )

    def judged(self, state: NavigatorState, output: Output) -> Output:
        """Return an output with the reason why its covariance makes the estimate unusable, if it does."""
        if output.odometry is None:
            return output
        return replace(output, unusable=self.unusable(state, output.odometry.stamp_ns))

    def unusable(self, state: NavigatorState, stamp_ns: int) -> str:
        """Return how the covariance of the estimate at a stamp exceeds the alert limit; empty if it does not.

        If several sensors support the track, the largest of their limits counts, as for the integrity.
        """
        if not state.mode.has_track or state.history is None:
            return ""
        newest = state.history.state
        predicted = predict(newest, max(stamp_ns, newest.stamp_ns), self._config)
        names = [
            name
            for name, stream in state.streams.items()
            if stream.supports(stamp_ns, self._stale_after_s, self._limits.silence_timeout_s)
        ]
        beyond = [_beyond(self._alerts[name], predicted) for name in names]
        return beyond[0] if beyond and all(beyond) else ""

    def _beyond(self, state: NavigatorState, predicted: FilterState) -> str:
        alert = next((self._alerts[name] for name in supporters(state.streams)), AlertLimit())
        return _beyond(alert, predicted)


def _leaves_open(state: NavigatorState, registration: Registration) -> bool:
    """Return whether a frame leaves a direction of the pose open.

    Its method says so (``undetermined``), or the covariance of the attitude does, whatever the method; or the
    filter assumes that the target may accelerate unseen there.
    """
    pose = registration.T_sensor_target
    if registration.belief.undetermined or pose is None or state.history is None:
        return bool(registration.belief.undetermined)
    newest = state.history.state
    covariance = newest.alike.with_free_variance(registration.covariance, rotation_matrix(pose), 0.0)
    return UNSEEN in newest.places() or degrees(worst_sigma(covariance[3:, 3:])) > MOST_SIGMA_DEG


def _beyond(alert: AlertLimit, predicted: FilterState) -> str:
    """Return how a covariance exceeds an alert limit; empty if it does not."""
    covariance = predicted.covariance[POSE, POSE]
    sigma_m, sigma_deg = worst_sigma(covariance[:3, :3]), degrees(worst_sigma(covariance[3:, 3:]))
    limit_m = alert.position_limit_m(float(np.linalg.norm(predicted.T_chaser_target.translation)))
    if sigma_deg > alert.attitude_deg:
        return f"sigma of the attitude {sigma_deg:.1f} deg, alert limit {alert.attitude_deg:g} deg"
    if sigma_m > limit_m:
        return f"sigma of the position {1e3 * sigma_m:.0f} mm, alert limit {1e3 * limit_m:.0f} mm"
    return ""
