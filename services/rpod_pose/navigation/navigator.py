"""The navigator: a pure state machine from measurements to estimates.

ACQUIRING  --a refined candidate is accepted-->             VERIFYING
VERIFYING  --the next frames agree-->                       TRACKING
TRACKING   --no accepted measurement for a while-->         COASTING
COASTING   --accepted at the prediction-->                  TRACKING
           --covariance beyond the alert limit-->           LOST
TRACKING   --too many frames inconsistent with the pose-->  LOST
LOST       --accepted near the prediction, or found-->      VERIFYING

``step(state, measurement) -> (state, output)`` knows neither bus nor clock: the daemon, a replay
of a log and a Monte-Carlo campaign run the same function. Searches run behind a port (``Searches``): while
one runs, the navigator processes further frames. The result is applied at a later frame.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import overload

from scipy.spatial.transform import RigidTransform

from rpod_pose.measurement import Measurement, Tick
from rpod_pose.navigation.challenger import Outcome
from rpod_pose.navigation.coasting import Coasting
from rpod_pose.navigation.contest import challenged
from rpod_pose.navigation.dynamics.options import CONSTANT, Dynamics
from rpod_pose.navigation.filter import FilterState
from rpod_pose.navigation.first_pose.beginning import Beginning, first_state
from rpod_pose.navigation.first_pose.catching_up import CatchingUp
from rpod_pose.navigation.first_pose.results import SearchResults
from rpod_pose.navigation.first_pose.searches import BEGUN, FOUND, Found, InlineSearches, Search, Searches
from rpod_pose.navigation.frames import as_measured, as_of_stamp
from rpod_pose.navigation.history import History
from rpod_pose.navigation.parallel import ParallelTracks
from rpod_pose.navigation.pose_measurement import PoseMeasurement
from rpod_pose.navigation.refusals import Refusals
from rpod_pose.navigation.registering import Registrar
from rpod_pose.navigation.results import Results
from rpod_pose.navigation.rivals import Rivals
from rpod_pose.navigation.sensors.newcomers import TOO_OLD, Newcomers, applied
from rpod_pose.navigation.sensors.ranges import Ranges
from rpod_pose.navigation.sensors.streams import (
    RESTS,
    heard,
    is_paused,
    silent_since_s,
    supported,
    unsupported_s,
)
from rpod_pose.navigation.state import Cause, NavigatorState, Output
from rpod_pose.ports import Methods, Registration
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator import EstimatorSettings
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.types import Mode
from rpod_target import NO_SYMMETRY, Equivalence, Joint


class Navigator:
    """The transitions between the states; the object holds only configuration and data of the target.

    Args:
        settings: settings of the estimator.
        methods: methods of each sensor, by its name.
        centre_of_mass_m: centre of mass of the target, target axes, shape (3,).
        alike: which attitudes of the target no measurement distinguishes; each estimate lists the poses of
            its turns as hypotheses, and no estimate turns about a free axis.
        joints: joints of the target, whose angles are estimated.
        dynamics: how tracks are predicted.
        searches: runs the searches; by default in the caller's thread, with the configured delay.
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
        searches: Searches | None = None,
    ) -> None:
        self._settings, self._limits = settings, settings.navigator
        self._methods, self._alike = methods, alike
        self._results = Results(settings.filter, alike)
        self._output = self._results.output
        self._coasting, self._refusals = Coasting(settings), Refusals(settings)
        self._beginning = Beginning(
            settings, centre_of_mass_m=centre_of_mass_m, alike=alike, joints=joints, dynamics=dynamics
        )
        self._parallel = ParallelTracks(self._beginning, settings.filter, alike)
        self._registrar = Registrar(methods, vague_deg=self._limits.tuning.vague_deg)
        self._catching_up = CatchingUp(settings, self._registrar)
        self._newcomers = Newcomers(settings, self._registrar, self._output, self._accepting)
        self._ranges = Ranges(settings.sensors)
        self._searches = searches or InlineSearches(methods, self._limits.tuning.search_delay_frames)
        self._found = SearchResults(
            settings,
            methods,
            beginning=self._beginning,
            parallel=self._parallel,
            output=self._output,
            alike=alike,
        )

    def start(
        self,
        pose: RigidTransform | None = None,
        *,
        covariance: FloatArray | None = None,
        stamp_ns: int | None = None,
    ) -> NavigatorState:
        """Return the first state; arguments as for ``first_state``."""
        return first_state(pose, covariance, stamp_ns)

    @overload
    def step(self, state: NavigatorState, event: Measurement) -> tuple[NavigatorState, Output]: ...
    @overload
    def step(self, state: NavigatorState, event: Tick) -> tuple[NavigatorState, Output | None]: ...
    def step(self, state: NavigatorState, event: Measurement | Tick) -> tuple[NavigatorState, Output | None]:
        """Return the next state and the output to publish; no output for a tick that changes nothing."""
        if isinstance(event, Tick):
            return self._let_time_pass(state, event)
        before, (state, why) = state, self._coasting.aged(state, event.stamp_ns)
        why = why if state.mode == Mode.LOST else ""
        state = replace(state, streams=heard(state.streams, event.sensor, event.stamp_ns))
        state, output = self._process(state, event)
        if why:
            output = output.after_loss(why, unsupported_s(before.streams, event.stamp_ns))
        if output.odometry is not None:
            state = replace(state, shown_ns=output.odometry.stamp_ns)
        if state.mode == Mode.TRACKING and not before.mode.has_track:  # no sensor needs a search any more
            state = replace(state, searches={})
        return state, self._coasting.judged(state, output)

    def _process(self, state: NavigatorState, event: Measurement) -> tuple[NavigatorState, Output]:
        """Apply the result of the sensor's search, if there is one, and then the measurement."""
        if state.given is not None:
            state = self._beginning.at_given(state, state.given, event)
        pending = state.searches.get(event.sensor)
        if pending is None or state.verifies_another(event.sensor):
            return self._dispatch(state, event)
        found = self._searches.result(pending)
        if found is None:
            return self._dispatch(state.searching(self._catching_up.waited(pending, event)), event)
        before = state.not_searching(event.sensor)
        state, then = self._apply_search(before, pending, found)
        follow = self._catching_up.needed(before, state, pending, found, event)
        state, output = self._dispatch(state, event) if follow is None else self._start_search(before, follow)
        return state, output.after_search(then, pending.age_s(event.stamp_ns))

    def _dispatch(self, state: NavigatorState, event: Measurement) -> tuple[NavigatorState, Output]:
        """Process a measurement: with rivals, without a pose, or with a predicted pose."""
        if state.rivals is not None:
            return self._track_rivals(state, state.rivals, event)
        if state.mode == Mode.ACQUIRING or state.history is None:
            return self._acquire(state, event)
        if state.lost_s(event.stamp_ns) > self._limits.tuning.near_search_s:
            return self._acquire(state, event)  # to predict would take longer and longer
        predicted = state.history.at(event.stamp_ns, self._settings.filter)
        if predicted is None:
            return state, self._output(state, event, reason=TOO_OLD)
        return self._with_prediction(state, state.history, predicted, event)

    def _with_prediction(
        self, state: NavigatorState, history: History, predicted: FilterState, event: Measurement
    ) -> tuple[NavigatorState, Output]:
        """Process a measurement for which there is a prediction."""
        if state.mode == Mode.LOST:
            return self._recover(state, predicted, event)
        if why := self._ranges.beyond(event.sensor, event.T_chaser_sensor.inv(), predicted.T_chaser_target):
            if state.mode == Mode.VERIFYING and event.sensor in state.established:
                state = state.acquiring()  # this sensor cannot verify the pose
            return state, self._output(state, event, reason=why, cause=Cause.OUT_OF_RANGE)
        if state.established and event.sensor not in state.established:
            return self._newcomers.offer(state, history, event)
        return self._track(state, history, predicted, event)

    def refuse(
        self, state: NavigatorState, sensor: str, stamp_ns: int, reason: str
    ) -> tuple[NavigatorState, Output]:
        """Return the state and the output at the stamp of a frame that is refused unprocessed."""
        aged, why = self._coasting.aged(state, stamp_ns)
        reason = f"{why}; {reason}" if aged.mode == Mode.LOST and why else reason
        state, output = self._results.silent(aged, stamp_ns, reason, sensor=sensor)
        return state, self._coasting.judged(state, output)

    def waiting(self, state: NavigatorState, search: Search, found: Found) -> Output:
        """Return the report about a search whose result waits for the next frame of its sensor.

        The state does not change, so that a replay gives the same estimates without this call.
        """
        found_one, registration = found.acquisition.begins_track, found.acquisition.registration
        reason = "" if found_one else found.acquisition.belief.refusal or search.reason
        report = FOUND if found_one else ""
        output = self._output(state, search.event, registration, reason=reason, search=report)
        return self._coasting.judged(state, output.with_evidence(BEGUN, 1.0))

    # --- searches ---

    def _start_search(self, state: NavigatorState, search: Search) -> tuple[NavigatorState, Output]:
        """Start a search; apply its result if it is available at once."""
        found = self._searches.result(search := replace(search, beside_track=state.mode.has_track))
        if found is not None:
            return self._apply_search(state, search, found)
        state = state.searching(replace(search, waited=1))
        reason = search.reason if search.registration else ""
        output = self._output(state, search.event, search.registration, reason=reason, search=search.report)
        return state, output.with_evidence(BEGUN, 1.0)

    def _apply_search(
        self, state: NavigatorState, search: Search, found: Found
    ) -> tuple[NavigatorState, Output]:
        """Apply the result of a search at the stamp of the searched frame."""
        if state.rivals is not None:
            return self._found.again(state, state.rivals, search, found)
        if state.history is None or not (state.mode == Mode.VERIFYING or state.mode.has_track):
            return self._found.first(state, search, found)
        predicted = state.history.at(search.event.stamp_ns, self._settings.filter)
        if predicted is None or search.registration is None:
            return state, self._output(state, search.event, reason=TOO_OLD)
        registration, reason = search.registration, search.reason
        if found.acquisition.begins_track:
            registration, reason = found.acquisition.registration, ""
        return self._registered(state, state.history, predicted, search.event, registration, reason=reason)

    # --- ACQUIRING ---

    def _acquire(self, state: NavigatorState, event: Measurement) -> tuple[NavigatorState, Output]:
        """Start a search without a guess, unless one is running or must pause."""
        if waiting := state.waiting(event.sensor, event.stamp_ns):
            return state, self._output(state, event, search=waiting)
        if self._must_pause(state, event):
            return state, self._output(state, event, reason=RESTS)
        angles = self._registrar.angles(state.joints, event)
        return self._start_search(state, Search(event, event.data, angles=angles))

    def _must_pause(self, state: NavigatorState, event: Measurement) -> bool:
        pause_s = self._limits.tuning.search_pause_s if len(self._methods) > 1 else 0.0
        return is_paused(state.streams, event.sensor, event.stamp_ns, pause_s)

    # --- rivals ---

    def _track_rivals(
        self, state: NavigatorState, rivals: Rivals, event: Measurement
    ) -> tuple[NavigatorState, Output]:
        """Track each rival. When one is probable enough, search again: no other pose may be as probable."""
        if rivals.tracks[0].history.before(event.stamp_ns, self._settings.filter) is None:
            return state, self._output(state, event, reason=TOO_OLD)
        apart_s = (event.stamp_ns - rivals.since_ns) / NANOSECONDS
        methods = self._methods[event.sensor]
        tracked = self._parallel.continued(rivals, event, methods)
        overdue = apart_s > self._limits.tuning.rivals_s
        if tracked is None and event.sensor != rivals.sensor and not overdue:
            return state, self._output(state, event, reason=rivals.reason(self._alike))
        if tracked is None or overdue:
            return self._acquire(replace(state, rivals=None, searches={}), event)
        rivals, registration = tracked
        state = replace(state, rivals=rivals)
        if (
            event.sensor not in state.searches
            and rivals.decided
            and registration.begins_track
            and self._registrar.is_confident(rivals.tracks[0].state)
        ):
            frame = as_of_stamp(event, rivals.tracks[0].state, methods.deskew)
            reason = rivals.reason(self._alike)
            return self._start_search(state, Search(event, frame, registration=registration, reason=reason))
        return self._found.keep_rivals(state, rivals, event, registration)

    # --- VERIFYING and TRACKING ---

    def _track(
        self, state: NavigatorState, history: History, predicted: FilterState, event: Measurement
    ) -> tuple[NavigatorState, Output]:
        """Register from the prediction, accept or reject the pose, update the filter."""
        tracked = state.mode.has_track
        registration, reason = self._registrar.register(state.joints, event, predicted, tracked=tracked)
        if reason and not (tracked and self._registrar.is_confident(predicted)):
            # While the twist is unknown, or after a gap, the prediction may be far from the true pose.
            if waiting := state.waiting(event.sensor, event.stamp_ns):
                return state, self._output(state, event, registration, reason=reason, search=waiting)
            search = self._registrar.around(state.joints, event, predicted)
            search = replace(search, registration=registration, reason=reason)
            if not state.established:  # a given pose that the first frame does not confirm
                state, search = state.acquiring(), replace(search, frame=event.data)
            return self._start_search(state, search)
        return self._registered(state, history, predicted, event, registration, reason=reason)

    def _registered(
        self,
        state: NavigatorState,
        history: History,
        predicted: FilterState,
        event: Measurement,
        registration: Registration,
        *,
        reason: str,
    ) -> tuple[NavigatorState, Output]:
        """Apply a registration: record its belief, update the filter, accept or reject the pose."""
        tracked, state = state.mode.has_track, state.recorded(event.sensor, registration)
        unsupported = state.unsupported_share(event.sensor)
        if tracked and unsupported > self._limits.tuning.max_contradicted_share:
            share = f"{unsupported:.0%} of the recent frames do not support the tracked pose"
            state = state.lost(event.stamp_ns)
            why = reason or registration.belief.reason or "the newest frame does"
            return self._reject(state, event, registration, reason=f"{share}: {why}")
        if reason:
            return self._reject(state, event, registration, reason=reason)
        measured = as_measured(registration, event, state.streams.get(event.sensor))
        measured = self._newcomers.beside.known(measured, predicted)
        measured = replace(measured, alone=tracked and registration.belief.is_proof)
        state, nis, accepted = applied(state, history, measured, self._settings.filter, predicted)
        if not accepted:
            reason = self._refusals.explain(history, predicted, measured, nis=nis, tracked=tracked)
            return self._refused(state, predicted, measured, event, registration, reason=reason, nis=nis)
        verified = state.confirmations >= self._limits.confirmations - 1 and self._beginning.is_credible(
            state, event.sensor
        )
        state = self._accepting(state, event, registration)
        mode = state.mode if tracked or verified else Mode.VERIFYING
        state = replace(state, mode=mode, established=state.established | {event.sensor})
        return state, self._output(state, event, registration, nis=nis)

    def _refused(
        self,
        state: NavigatorState,
        predicted: FilterState,
        measured: PoseMeasurement,
        event: Measurement,
        registration: Registration,
        *,
        reason: str,
        nis: float,
    ) -> tuple[NavigatorState, Output]:
        """Decide about a pose that the gate refuses; one that its frame proves may end the track."""
        if measured.alone and registration.begins_track:
            started = self._beginning.filter_at(measured, predicted)
            state, outcome = challenged(state, predicted, measured, started, self._settings.filter)
            if outcome == Outcome.LOST:
                return state, self._output(state, event, registration, reason=outcome.value, nis=nis)
            if outcome == Outcome.REPLACED:
                state = self._accepting(state, event, registration)
                return state, self._output(state, event, registration, nis=nis)
        return self._reject(state, event, registration, reason=reason, nis=nis)

    def _accepting(
        self, state: NavigatorState, event: Measurement, registration: Registration
    ) -> NavigatorState:
        state = replace(
            state.not_searching(event.sensor),
            streams=supported(state.streams, event.sensor, event.stamp_ns),
            confirmations=state.confirmations + 1,
            challenger=None,
            joints=self._beginning.joints_after(state.joints, registration.angles, event.stamp_ns),
        )
        return replace(state, mode=self._coasting.mode_after(state, registration, event.stamp_ns))

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
            state = state.acquiring()
        return state, self._output(state, event, registration, reason=reason, nis=nis)

    # --- LOST ---

    def _recover(
        self, state: NavigatorState, predicted: FilterState, event: Measurement
    ) -> tuple[NavigatorState, Output]:
        """Search near the prediction first, then everywhere."""
        registration, why = self._registrar.register(state.joints, event, predicted, tracked=False)
        if not why:
            if why := self._ranges.not_of(event.sensor, registration):
                return state, self._output(state, event, registration, reason=why, cause=Cause.OUT_OF_RANGE)
            state = self._beginning.at_found(state, event, registration)
            return state, self._output(state, event, registration)
        if waiting := state.waiting(event.sensor, event.stamp_ns):
            return state, self._output(state, event, search=waiting)
        search = self._registrar.around(state.joints, event, predicted)
        everywhere = None if self._must_pause(state, event) else event.data
        return self._start_search(state, replace(search, frame=everywhere, reason=RESTS))

    def _let_time_pass(self, state: NavigatorState, tick: Tick) -> tuple[NavigatorState, Output | None]:
        """Publish the prediction of a track while no sensor sends anything, until it is lost."""
        silent_s = silent_since_s(state.streams, tick.stamp_ns)
        if not state.mode.has_track or silent_s <= self._limits.silence_timeout_s:
            return state, None
        state, reason = self._coasting.aged(state, tick.stamp_ns)
        reason = reason or f"no usable frame for {silent_s:.1f} s"
        state, output = self._results.silent(state, tick.stamp_ns, reason)
        return state, self._coasting.judged(state, output)
