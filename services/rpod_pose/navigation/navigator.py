"""The navigator: a pure state machine from measurements to estimates.

ACQUIRING  --a refined candidate is accepted-->             VERIFYING
VERIFYING  --the next frames agree-->                       TRACKING
TRACKING   --no accepted measurement for a while-->         COASTING
COASTING   --accepted at the prediction-->                  TRACKING
           --covariance beyond the alert limit-->           LOST
TRACKING   --too many frames inconsistent with the pose-->  LOST
LOST       --accepted near the prediction, or found-->      VERIFYING

``step(state, measurement) -> (state, output)`` knows neither bus nor clock: the daemon, a replay
of a log and a Monte-Carlo campaign run the same function.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import overload

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_pose.belief import Record
from rpod_pose.measurement import Measurement, Tick
from rpod_pose.navigation.challenger import Outcome
from rpod_pose.navigation.coasting import Coasting
from rpod_pose.navigation.contest import challenged
from rpod_pose.navigation.dynamics.options import CONSTANT, Dynamics
from rpod_pose.navigation.filter import FilterState
from rpod_pose.navigation.frames import as_measured
from rpod_pose.navigation.history import History
from rpod_pose.navigation.joints import tracked_joints
from rpod_pose.navigation.parallel import ParallelTracks
from rpod_pose.navigation.pose_measurement import PoseMeasurement, started
from rpod_pose.navigation.registering import Registrar
from rpod_pose.navigation.results import Results
from rpod_pose.navigation.rivals import Rivals
from rpod_pose.navigation.sensors.newcomers import LATE, Newcomers, applied
from rpod_pose.navigation.sensors.ranges import Ranges
from rpod_pose.navigation.sensors.streams import (
    RESTS,
    begun,
    heard,
    rests,
    searched,
    silent_since_s,
    supported,
)
from rpod_pose.navigation.state import GivenPose, NavigatorState, Output
from rpod_pose.ports import Methods, Registration
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator import EstimatorSettings
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.types import Mode
from rpod_target import NO_SYMMETRY, Equivalence, Joint

BEGINNING = 0.5
"""Factor on the share at which a track is lost, below which one may begin, so that tracks do not flicker."""
_GIVEN_SIGMA_M, _GIVEN_SIGMA_RAD = 0.05, 0.26
"""Standard deviations of a given first pose without a given covariance."""


class Navigator:
    """The transitions; its only state is its configuration and data of the target.

    Args:
        settings: settings of the estimator.
        methods: methods of each sensor, by its name.
        centre_of_mass_m: centre of mass of the target, target axes, shape (3,).
        alike: which attitudes of the target no measurement tells apart; each estimate lists the poses that
            the turns give, and leaves the angle about a free axis as it is.
        joints: joints of the target, whose angles are estimated.
        dynamics: how tracks are predicted.
    """

    def __init__(
        self,
        settings: EstimatorSettings,
        methods: Mapping[str, Methods],
        *,
        centre_of_mass_m: FloatArray,
        alike: Equivalence = NO_SYMMETRY,
        joints: Sequence[Joint] = (),
        dynamics: Dynamics = CONSTANT,
    ) -> None:
        self._settings = settings
        self._alike = alike
        self._centre_of_mass_m, self._dynamics = centre_of_mass_m, dynamics
        self._results = Results(settings.filter, alike)
        self._output = self._results.output
        self._coasting = Coasting(settings)
        self._parallel = ParallelTracks(self._start_filter, settings.filter, alike)
        self._limits = settings.navigator
        self._registrar = Registrar(methods, vague_deg=self._limits.tuning.vague_deg)
        self._methods = methods
        self._newcomers = Newcomers(settings, self._registrar, self._output, self._accepting)
        self._ranges = Ranges(settings.sensors)
        self._joints = {joint.name: joint for joint in joints}

    def _start_filter(self, measured: PoseMeasurement) -> FilterState:
        return started(
            measured,
            config=self._settings.filter,
            centre_of_mass_m=self._centre_of_mass_m,
            alike=self._alike,
            blocks=self._dynamics.blocks_at(measured.stamp_ns),
            model=self._dynamics.model,
        )

    def start(
        self,
        pose: RigidTransform | None = None,
        *,
        covariance: FloatArray | None = None,
        stamp_ns: int | None = None,
    ) -> NavigatorState:
        """Return the first state: searching, or waiting for a frame to verify a given pose."""
        if pose is None:
            return NavigatorState()
        if covariance is None:
            covariance = np.diag([_GIVEN_SIGMA_M**2] * 3 + [_GIVEN_SIGMA_RAD**2] * 3)
        return NavigatorState(mode=Mode.VERIFYING, given=GivenPose(pose, covariance, stamp_ns))

    @overload
    def step(self, state: NavigatorState, event: Measurement) -> tuple[NavigatorState, Output]: ...
    @overload
    def step(self, state: NavigatorState, event: Tick) -> tuple[NavigatorState, Output | None]: ...
    def step(self, state: NavigatorState, event: Measurement | Tick) -> tuple[NavigatorState, Output | None]:
        """Return the next state and the output to publish; no output for a tick that changes nothing."""
        if isinstance(event, Tick):
            return self._let_time_pass(state, event)
        state, why = self._coasting.aged(state, event.stamp_ns)
        why *= state.mode == Mode.LOST
        state = replace(state, streams=heard(state.streams, event.sensor, event.stamp_ns))
        state, output = self._take(state, event)
        if why and state.mode == Mode.LOST:
            output = output.because(why)
        if output.odometry is not None:
            state = replace(state, shown_ns=output.odometry.stamp_ns)
        return state, output

    def _take(self, state: NavigatorState, event: Measurement) -> tuple[NavigatorState, Output]:
        if state.given is not None:
            state = self._start_at_given(state, event)
        if state.rivals is not None:
            return self._compare(state, state.rivals, event)
        if state.mode == Mode.ACQUIRING or state.history is None:
            return self._acquire(state, event)
        predicted = state.history.at(event.stamp_ns, self._settings.filter)
        if predicted is None:
            return state, self._output(state, event, reason=LATE)
        return self._follow(state, state.history, predicted, event)

    def _follow(
        self, state: NavigatorState, history: History, predicted: FilterState, event: Measurement
    ) -> tuple[NavigatorState, Output]:
        """Take a measurement for which there is a prediction."""
        if state.mode == Mode.LOST:
            return self._recover(state, predicted, event)
        if why := self._ranges.beyond(event.sensor, event.T_chaser_sensor.inv(), predicted.T_chaser_target):
            return state, self._output(state, event, reason=why)
        if state.established and event.sensor not in state.established:
            return self._newcomers.offer(state, history, event)
        return self._track(state, history, predicted, event)

    def refuse(
        self, state: NavigatorState, sensor: str, stamp_ns: int, reason: str
    ) -> tuple[NavigatorState, Output]:
        """Return the state and the output at the stamp of a frame without content of its own."""
        aged, _ = self._coasting.aged(state, stamp_ns)
        return self._results.silent(aged, stamp_ns, reason, sensor=sensor)

    # --- ACQUIRING ---

    def _acquire(self, state: NavigatorState, event: Measurement) -> tuple[NavigatorState, Output]:
        """Search without a guess; begin a track if one pose explains the measurement."""
        pause_s = self._limits.tuning.search_pause_s if len(self._methods) > 1 else 0.0
        if rests(state.streams, event.sensor, event.stamp_ns, pause_s):
            return state, self._output(state, event, reason=RESTS)
        found = self._registrar.methods_for(state.joints, event).acquirer.acquire(event.data)
        state = replace(state, streams=searched(state.streams, event.sensor, event.stamp_ns))
        if why := self._ranges.not_of(event.sensor, found):
            return state, self._output(state, event, reason=why)
        if found.begins_track:
            return self._begin(state, event, found.registration)
        if self._methods[event.sensor].likelihoods is not None:
            tracks = self._parallel.started(event, found)
            if 1 < len(tracks) <= self._limits.tuning.most_rivals:
                rivals = Rivals(
                    tracks, event.sensor, event.stamp_ns, event.stamp_ns, found.belief.needed_weight
                )
                state = replace(state, rivals=rivals)
        return state, self._output(state, event, found.registration, reason=found.belief.refusal, found=found)

    def _begin(
        self, state: NavigatorState, event: Measurement, registration: Registration
    ) -> tuple[NavigatorState, Output]:
        unverified = self._limits.confirmations > 0 or not self._is_credible(state, event)
        state = replace(
            state,
            mode=Mode.VERIFYING if unverified else Mode.TRACKING,
            history=History(self._start_filter(as_measured(registration, event))),
            streams=begun(state.streams, event.sensor, event.stamp_ns),
            established=frozenset({event.sensor}),
            separation=None,
            confirmations=0,
            joints=tracked_joints(state.joints, self._joints, registration.angles, event.stamp_ns),
        )
        return state, self._output(state, event, registration)

    # --- rivals ---

    def _compare(
        self, state: NavigatorState, rivals: Rivals, event: Measurement
    ) -> tuple[NavigatorState, Output]:
        """Track each rival; begin a track if one of them remains, also beside those of a new search."""
        if rivals.tracks[0].history.before(event.stamp_ns, self._settings.filter) is None:
            return state, self._output(state, event, reason=LATE)
        apart_s = (event.stamp_ns - rivals.since_ns) / NANOSECONDS
        methods = self._methods[event.sensor]
        tracked = self._parallel.continued(rivals, event, methods)
        overdue = apart_s > self._limits.tuning.rivals_s
        if tracked is None and event.sensor != rivals.sensor and not overdue:
            return state, self._output(state, event, reason=rivals.reason(self._alike))
        if tracked is None or overdue:
            return self._acquire(replace(state, rivals=None), event)
        rivals, registration = tracked
        if (
            rivals.decided
            and registration.begins_track
            and self._registrar.is_confident(rivals.tracks[0].state)
        ):
            again = self._parallel.searched_again(rivals, event, methods)
            rivals = again or rivals
            if again and rivals.decided:
                return self._begin_remaining(state, rivals, event, registration)
        if len(rivals.tracks) > self._limits.tuning.most_rivals:
            state = replace(state, rivals=None)
        else:
            state = replace(state, rivals=rivals)
        return state, self._output(state, event, registration, reason=rivals.reason(self._alike))

    def _begin_remaining(
        self, state: NavigatorState, rivals: Rivals, event: Measurement, registration: Registration
    ) -> tuple[NavigatorState, Output]:
        verified = rivals.frames >= self._limits.confirmations and self._is_credible(state, event)
        state = replace(
            state,
            mode=Mode.TRACKING if verified else Mode.VERIFYING,
            rivals=None,
            history=rivals.tracks[0].history,
            streams=begun(state.streams, event.sensor, event.stamp_ns),
            established=frozenset({event.sensor}),
            separation=None,
            confirmations=rivals.frames,
        )
        return state, self._output(state, event, registration)

    def _start_at_given(self, state: NavigatorState, event: Measurement) -> NavigatorState:
        given = state.given
        assert given is not None  # noqa: S101 - guaranteed by the caller
        stamp_ns = event.stamp_ns if given.stamp_ns is None else min(given.stamp_ns, event.stamp_ns)
        return replace(
            state,
            mode=Mode.VERIFYING,
            given=None,
            history=History(
                self._start_filter(PoseMeasurement(stamp_ns, given.T_chaser_target, given.covariance))
            ),
            streams=begun(state.streams),
            established=frozenset(),
            separation=None,
            confirmations=self._limits.confirmations - 1,
        )

    # --- VERIFYING and TRACKING ---

    def _track(
        self, state: NavigatorState, history: History, predicted: FilterState, event: Measurement
    ) -> tuple[NavigatorState, Output]:
        """Register from the prediction, accept or reject the pose, update the filter."""
        tracked = state.mode.has_track
        registration, reason = self._registrar.searched(state.joints, event, predicted, tracked=tracked)
        record = state.records.get(event.sensor, Record())
        if registration.T_sensor_target is not None:
            record = record.after(registration.belief)
        state = replace(state, records={**state.records, event.sensor: record})
        if tracked and record.share > self._limits.tuning.max_contradicted_share:
            share = f"{record.share:.0%} of the recent frames do not support the tracked pose"
            state = replace(state, mode=Mode.LOST, lost_ns=event.stamp_ns)
            return self._reject(state, event, registration, reason=f"{share}: {reason}" if reason else share)
        if reason:
            return self._reject(state, event, registration, reason=reason)
        measured = as_measured(registration, event)
        state, nis, accepted = applied(state, history, measured, self._settings.filter)
        if not accepted:
            if tracked and registration.begins_track:
                started = self._start_filter(measured)
                state, outcome = challenged(state, predicted, measured, started, self._settings.filter)
                if outcome != Outcome.OPEN:
                    reason = outcome.value if outcome == Outcome.LOST else ""
                    return state, self._output(state, event, registration, reason=reason, nis=nis)
            return self._reject(state, event, registration, reason=f"gate: nis {nis:.1f}", nis=nis)
        verified = state.confirmations >= self._limits.confirmations - 1 and self._is_credible(state, event)
        state = replace(
            self._accepting(state, event, registration),
            mode=Mode.TRACKING if tracked or verified else Mode.VERIFYING,
            established=state.established | {event.sensor},
        )
        return state, self._output(state, event, registration, nis=nis)

    def _accepting(
        self, state: NavigatorState, event: Measurement, registration: Registration
    ) -> NavigatorState:
        return replace(
            state,
            streams=supported(state.streams, event.sensor, event.stamp_ns),
            confirmations=state.confirmations + 1,
            challenger=None,
            joints=tracked_joints(state.joints, self._joints, registration.angles, event.stamp_ns),
        )

    def _reject(
        self,
        state: NavigatorState,
        event: Measurement,
        registration: Registration,
        *,
        reason: str,
        nis: float = float("nan"),
    ) -> tuple[NavigatorState, Output]:
        """Continue with the prediction; drop a pose that fails verification."""
        if state.mode == Mode.VERIFYING:
            state = replace(state, mode=Mode.ACQUIRING, history=None)
        return state, self._output(state, event, registration, reason=reason, nis=nis)

    def _is_credible(self, state: NavigatorState, event: Measurement) -> bool:
        """Return whether a track may begin: few recent frames of the sensor were inconsistent."""
        share = state.records.get(event.sensor, Record()).share
        return share <= BEGINNING * self._limits.tuning.max_contradicted_share

    # --- LOST ---

    def _recover(
        self, state: NavigatorState, predicted: FilterState, event: Measurement
    ) -> tuple[NavigatorState, Output]:
        """Search near the prediction first, then everywhere."""
        if (event.stamp_ns - state.lost_ns) / NANOSECONDS <= self._limits.near_search_s:
            registration, why = self._registrar.searched(state.joints, event, predicted, tracked=False)
            if not why:
                return self._begin(state, event, registration)
        return self._acquire(state, event)

    def _let_time_pass(self, state: NavigatorState, tick: Tick) -> tuple[NavigatorState, Output | None]:
        """Publish the prediction of a track while no sensor sends anything, until it is lost."""
        silent_s = silent_since_s(state.streams, tick.stamp_ns)
        if not state.mode.has_track or silent_s <= self._limits.silence_timeout_s:
            return state, None
        state, reason = self._coasting.aged(state, tick.stamp_ns)
        return self._results.silent(state, tick.stamp_ns, reason or f"no frame for {silent_s:.1f} s")
