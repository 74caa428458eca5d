"""The estimator without a bus: methods of each sensor, the navigator's state, and resets.

The daemon passes frames from the bus to it, a replay passes frames from a log.
"""

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np

from rpod_estimator.ahead import Ahead
from rpod_estimator.frame_hint import described
from rpod_estimator.frame_reader import Arrived
from rpod_estimator.live_searches import LiveSearches
from rpod_estimator.target_notes import tell_of_target
from rpod_pose.measurement import Measurement, Tick
from rpod_pose.methods import kind_methods, ready_methods
from rpod_pose.navigation.dynamics.command_track import CommandTrack
from rpod_pose.navigation.dynamics.imu_track import ImuTrack
from rpod_pose.navigation.dynamics.options import Dynamics
from rpod_pose.navigation.dynamics.slewing import doubts, told
from rpod_pose.navigation.first_pose.searches import InlineSearches, Searches
from rpod_pose.navigation.integrity.memory import Memory
from rpod_pose.navigation.integrity.monitor import Monitor
from rpod_pose.navigation.integrity.wrong_streams import CLOCK_MOVED_S
from rpod_pose.navigation.navigator import Navigator
from rpod_pose.navigation.state import Cause, NavigatorState, Output
from rpod_pose.ports import Methods
from rpod_pose.surroundings.bodies import KnownBodies, KnownBodiesError
from rpod_pose.surroundings.known import (
    KnownParts,
    KnownSurroundingsError,
    known_bodies,
    known_parts,
)
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.config.sensor import SensorInput
from rpod_schemas.control import Accepted, ResetRequest
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.topics import CHASER
from rpod_schemas.types import EstimatorStatus, Integrity, Mode
from rpod_target import Target

log = logging.getLogger(__name__)

OpenSearches = Callable[[Mapping[str, Methods], Mapping[str, Any]], Searches]
"""Function that opens the port for searches, from the methods and setups of the sensors, by name."""
TICK_S = 0.1
"""Time between two ticks while no frame arrives."""
SLOW_SEARCH_S = 4.0
"""Time after which the status reports that a search takes long, together with the measured distances. A
search for a first pose takes less time, unless other things are in view."""
SLOW_SEARCH = "its search for a first pose takes long"
ASSUMED_AGAIN = "poses agree again with what is assumed of the chaser, by its commands or a held attitude"
_TICK_NS = round(TICK_S * NANOSECONDS)


@dataclass(frozen=True, eq=False)
class Unjudged:
    """A result whose integrity is not known yet."""

    output: Output
    state: NavigatorState
    """State of the navigator after it."""
    frozen: bool
    """Whether its frame was refused because its stream is frozen."""
    forgets: bool
    """Whether a reset came before it."""


class Estimator:
    """Holds the navigator and its state between frames; resets may come from another thread.

    Args:
        config: configuration.
        target: the target to find and track.
        searches: function that opens the port for searches; None for searches in the caller's thread.
    """

    def __init__(self, config: EstimatorConfig, target: Target, searches: OpenSearches | None = None) -> None:
        self._config, self._target = config, target
        self._sensors = {sensor.name: sensor for sensor in config.sensors}
        self._side_m = float(np.sort(np.ptp(target.triangles_m.reshape(-1, 3), axis=0))[1])
        """Second longest side of the target, by its axes."""
        self._setups: dict[str, Any] = {}
        self._methods: dict[str, Methods] = {}
        self._known: dict[str, KnownParts] = {}
        self._ahead = Ahead(config)
        self.bodies = self._known_bodies()
        """Known bodies beside the target, whose poses a receiver adds; None for none."""
        tell_of_target(config, target)
        self.learn({})
        self._dynamics = Dynamics.of(config.dynamics, target)
        if self._dynamics.assumption:
            log.warning("%s", self._dynamics.assumption)
        delay_frames = config.navigator.tuning.search_delay_frames
        self._searches: Searches = (
            InlineSearches(self._methods, delay_frames)
            if searches is None
            else searches(self._methods, self._setups)
        )
        self._navigator = Navigator(
            config,
            self._methods,
            centre_of_mass_m=target.centre_of_mass_m,
            alike=target.equivalence,
            joints=target.joints,
            dynamics=self._dynamics,
            searches=self._searches,
        )
        self._state: NavigatorState = self._navigator.start(config.initial_pose)
        self._monitor, self._memory, self._forgets = Monitor(config), Memory(), False
        self._resets: SimpleQueue[ResetRequest] = SimpleQueue()
        self._passed_ns: int | None = None
        self._is_reset = False
        self._ticked_ns = 0
        self._doubts: tuple[str, ...] = ()

    @property
    def mode(self) -> Mode:
        """State of the navigator."""
        return self._state.mode

    @property
    def pins_setups(self) -> bool:
        """Whether the setups of the sensors must not change, because a track uses them."""
        return self.mode != Mode.ACQUIRING and self._config.changed_setup == "refuse"

    def learn(self, infos: Mapping[str, Any]) -> None:
        """Create a sensor's methods as soon as its setup is known, and again when its info changes.

        This also loads the compiled code of the methods.

        Args:
            infos: the newest info message of each sensor, by sensor name.
        """
        for name, sensor in self._sensors.items():
            setup = kind_methods(sensor).setup(sensor, infos.get(name))
            if setup is None or setup == self._setups.get(name):
                continue
            if infos.get(name) is not None:
                log.info("%s: %s", name, setup)
            self._setups[name] = setup
            self._methods[name] = self._ahead.following(name, ready_methods(sensor, self._target, setup))
            self._learn_surroundings(sensor, setup)

    def _known_bodies(self) -> KnownBodies | None:
        path = self._config.surroundings
        try:
            return known_bodies(path)
        except KnownBodiesError as error:
            raise ConfigurationError(str(path), "bodies", str(error)) from error

    def _learn_surroundings(self, sensor: SensorInput, setup: Any) -> None:
        path, separation = self._config.surroundings, kind_methods(sensor).separation
        if path is None:
            return
        try:
            frames = None if separation is None else separation(sensor, setup)
            known = known_parts(path, sensor.name, frames, self.bodies)
        except KnownSurroundingsError as error:
            raise ConfigurationError(path, sensor.name, str(error)) from error
        if known is not None:
            self._known[sensor.name] = known

    @property
    def imu(self) -> ImuTrack | None:
        """Readings of the chaser's IMU, to which its receiver adds; None if it is not used."""
        return self._dynamics.imu

    @property
    def commands(self) -> CommandTrack | None:
        """Commanded accelerations of the chaser, to which their receiver adds; None if they are not used."""
        return self._dynamics.commands

    @property
    def uses_readings(self) -> bool:
        """Whether predictions use readings or commands of the chaser, which arrive between frames."""
        return self.imu is not None or self.commands is not None

    def request_reset(self, request: ResetRequest) -> Accepted:
        """Start again with the next frame, without a pose or from a given pose."""
        check_reset(request)
        self._resets.put(request)
        return Accepted()

    def _take_resets(self) -> None:
        while True:
            try:
                request = self._resets.get_nowait()
            except Empty:
                return
            log.info(
                "reset: the estimator starts again %s",
                "from the given pose" if request.pose is not None else "without a pose",
            )
            started = self._navigator.start(
                request.pose, covariance=request.covariance, stamp_ns=request.stamp_ns
            )
            self._state = replace(started, shown_ns=self._state.shown_ns)
            self._forgets, self._is_reset = True, True
            self._searches.keep(())

    def _begin_anew(self, stamp_ns: int) -> None:
        """Forget data that are newer than the first frame after a reset, in case a clock was set back."""
        self._is_reset = False
        if stamp_ns >= self._state.shown_ns - round(self._config.filter.max_delay_s * NANOSECONDS):
            return
        self._state = replace(self._state, shown_ns=0)
        for track in self.bodies.tracks.values() if self.bodies is not None else ():
            track.forget()
        for readings in (self.imu, self.commands):
            if readings is not None:
                readings.forget()

    def ahead(self, arrived: Arrived) -> Callable[[], None] | None:
        """Return the function that registers a frame before it is processed; None if that is of no use.

        It may run in another thread, while frames of other sensors are processed. The results of ``process``
        are the same with and without it.
        """
        measurement, is_alone = arrived.measurement, len(self._sensors) == 1
        if measurement is None or is_alone or arrived.sensor not in self._methods.keys() - self._known.keys():
            return None
        return self._ahead.of(self._state, measurement, self._methods[arrived.sensor])

    def may_pass(self, arrived: Arrived, sensor: str) -> bool:
        """Return whether a frame may be processed before a sensor's earlier one that is registered ahead.

        The track must not coast, and its limits must not change, for want of that frame.
        """
        return self._ahead.may_pass(self._state, sensor, arrived.stamp_ns)

    def process(self, arrived: Arrived) -> Output:
        """Process a frame and return the result."""
        output, moved_s = self._processed(arrived), arrived.clock_moved_s
        return output.with_evidence(CLOCK_MOVED_S, moved_s) if moved_s else output

    def _processed(self, arrived: Arrived) -> Output:
        self._take_resets()
        if arrived.measurement is None:
            return self._rejected(arrived, arrived.reason)
        before, measurement = self._state.mode, arrived.measurement
        if arrived.sensor not in self._methods:
            missing = kind_methods(self._sensors[arrived.sensor]).missing
            return self._rejected(arrived, self._hinted(missing, measurement))
        if self._is_reset:
            self._begin_anew(measurement.stamp_ns)
        if known := self._known.get(arrived.sensor):
            try:
                left = known.of_target(measurement.data, measurement.stamp_ns, measurement.T_chaser_sensor)
                measurement = replace(measurement, data=left)
            except KnownSurroundingsError as error:
                return self._rejected(arrived, str(error))
        self._state, output = self._navigator.step(self._state, measurement)
        if not output.status.accepted and not output.status.mode.has_track:
            output = self._with_hint(output, measurement)
        self._searches.keep(self._state.searches.values())
        self._log_change(before, output)
        return output

    def _with_hint(self, output: Output, measurement: Measurement) -> Output:
        """Return the result of a frame without a pose, with the reason and a hint from its distances."""
        why, cause = output.why, output.cause
        if not why and self._searches_long(measurement):
            why, cause = SLOW_SEARCH, Cause.SLOW_SEARCH
        if not why:
            return output
        return output.explained(self._hinted(why, measurement), cause)

    def _hinted(self, why: str, measurement: Measurement) -> str:
        """Return a reason with what a frame measures."""
        hint = described(measurement.data, radius_m=self._target.radius_m, side_m=self._side_m)
        return f"{why} ({hint})" if hint else why

    def _searches_long(self, measurement: Measurement) -> bool:
        """Return whether the search for which a frame waits takes long."""
        search = self._state.searches.get(measurement.sensor)
        if search is None:
            return False
        return measurement.stamp_ns - search.event.stamp_ns >= SLOW_SEARCH_S * NANOSECONDS

    def integrity(self, output: Output, *, frozen: bool = False) -> Integrity:
        """Return the integrity of the newest result; to be called once for each result.

        Args:
            output: the result.
            frozen: whether its frame was refused because its stream is frozen.
        """
        return self.judge(self.unjudged(output, frozen=frozen))

    def unjudged(self, output: Output, *, frozen: bool = False) -> Unjudged:
        """Return what ``judge`` needs to know of the newest result; arguments as for ``integrity``."""
        forgets, self._forgets = self._forgets, False
        return Unjudged(output, self._state, frozen, forgets)

    def judge(self, result: Unjudged) -> Integrity:
        """Return the integrity of a result; to be called once for each, in their order, from any thread."""
        memory = Memory() if result.forgets else self._memory
        self._memory, found = self._monitor.assess(memory, result.state, result.output, frozen=result.frozen)
        return found

    def tick(self, now_ns: int) -> Output | None:
        """Advance the time without a frame; return a result if the mode changes, or the track coasts."""
        self._take_resets()
        before = self._state.mode
        if self._ticked_ns <= now_ns < self._ticked_ns + _TICK_NS:
            return None  # a daemon's ticks are more frequent than the messages of a track that coasts
        self._state, output = self._navigator.step(self._state, Tick(now_ns))
        if output is not None:
            self._ticked_ns = now_ns
            self._log_change(before, output)
        return output

    def unreported(self, now_ns: int, searches: LiveSearches) -> Iterator[Output]:
        """Yield the results of ended searches whose sensor is silent: no further frame reports them."""
        for name, stream in self._state.streams.items():
            if not stream.is_silent(now_ns, self._config.navigator.silence_timeout_s):
                continue
            if (ended := searches.unreported(name)) is not None:
                yield self._with_hint(self._navigator.waiting(self._state, *ended), ended[0].event)

    def let_time_pass(self, until_ns: int) -> Iterator[Output]:
        """Advance the time in ticks from the stamp of the newest frame up to a stamp; yield results.

        Lockstep and replay call this, so that their results do not depend on the machine's load.
        """
        if self._passed_ns is not None:
            for now_ns in range(self._passed_ns + _TICK_NS, until_ns, _TICK_NS):
                if not self.mode.has_track:
                    break  # later ticks change nothing
                if output := self.tick(now_ns):
                    yield output
        self._passed_ns = max(until_ns, self._passed_ns or 0)

    def _rejected(self, arrived: Arrived, reason: str) -> Output:
        if arrived.measurement is None and arrived.came_in_time:  # a track goes on as a prediction
            before = self._state.mode
            self._state, output = self._navigator.refuse(
                self._state, arrived.sensor, arrived.stamp_ns, reason
            )
            self._log_change(before, output)
            return output
        status = EstimatorStatus(
            stamp_ns=arrived.stamp_ns,
            frame_id=CHASER,
            mode=self._state.mode,
            sensor=arrived.sensor,
            reason=reason,
        )
        return Output(status, None)

    def _log_change(self, before: Mode, output: Output) -> None:
        doubted = () if self._state.history is None else doubts(self._state.history.state)
        if doubted != self._doubts:
            log.warning("dynamics: %s", told(doubted) or ASSUMED_AGAIN)
            self._doubts = doubted
        if output.status.mode != before:
            reason = output.lost or output.status.reason
            log.info("%s -> %s%s", before.name, output.status.mode.name, f": {reason}" if reason else "")


def check_reset(request: ResetRequest) -> None:
    """Check the pose of a reset. Raises ``ConfigurationError``."""
    if request.pose is not None and request.frame_id != CHASER:
        raise ConfigurationError(
            "reset", "frame_id", f"{request.frame_id!r}, but poses are taken in {CHASER!r}: transform it"
        )
