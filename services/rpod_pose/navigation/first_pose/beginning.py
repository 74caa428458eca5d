"""The beginning of a track: at a pose that was found, at the rival that remains, or at a given pose."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_pose.belief import Angle
from rpod_pose.measurement import Measurement
from rpod_pose.navigation.dynamics.options import Dynamics
from rpod_pose.navigation.filter import FilterState
from rpod_pose.navigation.first_pose.carried import carried
from rpod_pose.navigation.frames import as_measured
from rpod_pose.navigation.history import History, apply
from rpod_pose.navigation.joints import JointTrack, tracked_joints
from rpod_pose.navigation.pose_measurement import PoseMeasurement, started
from rpod_pose.navigation.rivals import Rivals
from rpod_pose.navigation.sensors.streams import begun
from rpod_pose.navigation.state import GivenPose, NavigatorState
from rpod_pose.ports import Registration
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator import EstimatorSettings
from rpod_schemas.types import Mode
from rpod_target import Equivalence, Joint

_GIVEN_SIGMA_M, _GIVEN_SIGMA_RAD = 0.05, 0.26
"""Standard deviations of a given first pose without a given covariance. Hand: 5 cm and 15 deg."""


class Beginning:
    """Begins tracks; the object holds only configuration and data of the target.

    Args:
        settings: settings of the estimator.
        centre_of_mass_m: centre of mass of the target, target axes, shape (3,).
        alike: which attitudes of the target no measurement distinguishes.
        joints: joints of the target, whose angles are estimated.
        dynamics: how tracks are predicted.
    """

    def __init__(
        self,
        settings: EstimatorSettings,
        *,
        centre_of_mass_m: FloatArray,
        alike: Equivalence,
        joints: Sequence[Joint],
        dynamics: Dynamics,
    ) -> None:
        self._config, self._limits = settings.filter, settings.navigator
        self._centre_of_mass_m, self._alike, self._dynamics = centre_of_mass_m, alike, dynamics
        self._joints = {joint.name: joint for joint in joints}

    def filter_at(self, measured: PoseMeasurement, past: FilterState | None = None) -> FilterState:
        """Return a filter that starts at a measured pose, with what stays of the filter before it, if any."""
        return started(
            measured,
            config=self._config,
            centre_of_mass_m=self._centre_of_mass_m,
            alike=self._alike,
            blocks=self._dynamics.blocks_at(measured.stamp_ns),
            known=None if past is None else carried(past, measured, self._config),
            model=self._dynamics.model,
        )

    def joints_after(
        self, tracks: Mapping[str, JointTrack], angles: Mapping[str, Angle], stamp_ns: int
    ) -> Mapping[str, JointTrack]:
        """Return the tracks of the target's joints after a frame that shows their angles."""
        return tracked_joints(tracks, self._joints, angles, stamp_ns)

    def is_credible(self, state: NavigatorState, sensor: str) -> bool:
        """Return whether a track may begin: few recent frames of the sensor were inconsistent."""
        return state.unsupported_share(sensor) <= self._limits.tuning.max_beginning_share

    def at_found(
        self,
        state: NavigatorState,
        event: Measurement,
        registration: Registration,
        before: PoseMeasurement | None = None,
    ) -> NavigatorState:
        """Return the state with a track that begins at the pose of a frame.

        Args:
            state: state without a track.
            event: the frame.
            registration: its registration.
            before: pose in an earlier frame, from which it was followed; None if there is none.
        """
        unverified = self._limits.confirmations > 0 or not self.is_credible(state, event.sensor)
        return replace(
            state.not_searching(event.sensor),
            mode=Mode.VERIFYING if unverified else Mode.TRACKING,
            history=self._history(as_measured(registration, event), before, state.before_loss),
            streams=begun(state.streams, event.sensor, event.stamp_ns),
            established=frozenset({event.sensor}),
            separation=None,
            challenger=None,
            confirmations=0,
            joints=self.joints_after(state.joints, registration.angles, event.stamp_ns),
        )

    def _history(
        self, measured: PoseMeasurement, before: PoseMeasurement | None, past: FilterState | None
    ) -> History:
        """Return a history that begins at a pose, or at an earlier one that agrees with it.

        Args:
            measured: the pose.
            before: an earlier one, from which it was followed; None if there is none.
            past: the filter before; None if there was none.
        """
        if before is not None:
            followed = apply(History(self.filter_at(before, past)), measured, self._config)
            if followed.accepted:
                return followed.history
        return History(self.filter_at(measured, past))

    def at_remaining(self, state: NavigatorState, rivals: Rivals, event: Measurement) -> NavigatorState:
        """Return the state with the track of the best rival, which continues from its parallel track."""
        verified = rivals.frames >= self._limits.confirmations and self.is_credible(state, event.sensor)
        return replace(
            state,
            mode=Mode.TRACKING if verified else Mode.VERIFYING,
            rivals=None,
            history=rivals.tracks[0].history,
            streams=begun(state.streams, event.sensor, event.stamp_ns),
            established=frozenset({event.sensor}),
            separation=None,
            challenger=None,
            confirmations=rivals.frames,
            joints=rivals.tracks[0].joints,
            searches={},
        )

    def at_given(self, state: NavigatorState, given: GivenPose, event: Measurement) -> NavigatorState:
        """Return the state with a track that begins at a given pose, which is to be verified."""
        stamp_ns = event.stamp_ns if given.stamp_ns is None else min(given.stamp_ns, event.stamp_ns)
        measured = PoseMeasurement(stamp_ns, given.T_chaser_target, given.covariance)
        return replace(
            state,
            mode=Mode.VERIFYING,
            given=None,
            history=History(self.filter_at(measured)),
            streams=begun(state.streams),
            established=frozenset(),
            separation=None,
            challenger=None,
            confirmations=self._limits.confirmations - 1,
            searches={},
        )


def first_state(
    pose: RigidTransform | None, covariance: FloatArray | None, stamp_ns: int | None
) -> NavigatorState:
    """Return the first state: searching, or waiting for a frame to verify a given pose.

    Args:
        pose: T_chaser_target; None to search for it.
        covariance: covariance of its (dp, dtheta), chaser axes, ICD section 1, shape (6, 6); None if unknown.
        stamp_ns: its stamp, ns of UTC; None for that of the first frame.
    """
    if pose is None:
        return NavigatorState()
    if covariance is None:
        covariance = np.diag([_GIVEN_SIGMA_M**2] * 3 + [_GIVEN_SIGMA_RAD**2] * 3)
    return NavigatorState(mode=Mode.VERIFYING, given=GivenPose(pose, covariance, stamp_ns))
