"""The estimator without its bus: methods by sensor, the navigator's state, resets.

The daemon feeds it from the bus, a replay from a log.
"""

import logging
from collections.abc import Iterator, Mapping
from dataclasses import replace
from queue import Empty, SimpleQueue

from rpod_estimator.intake import Arrived
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.measurement import Tick
from rpod_pose.methods import configured_pattern, lidar_methods, pmd_methods, warm_up
from rpod_pose.navigation.navigator import Navigator
from rpod_pose.navigation.state import NavigatorState, Output
from rpod_pose.ports import Methods
from rpod_schemas.config.estimator import EstimatorConfig, LidarInput, SensorInput
from rpod_schemas.control import Accepted, ResetRequest
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.topics import CHASER
from rpod_schemas.types import EstimatorStatus, Mode
from rpod_target import Target

log = logging.getLogger(__name__)

TICK_S = 0.1
"""How often time passes without a frame."""
_TICK_NS = round(TICK_S * NANOSECONDS)


class Estimator:
    """Navigator and state, between the frames; resets may come from another thread."""

    def __init__(self, config: EstimatorConfig, target: Target) -> None:
        self._config, self._target = config, target
        self._sensors = {sensor.name: sensor for sensor in config.sensors}
        self._patterns = {name: configured_pattern(sensor) for name, sensor in self._sensors.items()}
        self._methods: dict[str, Methods] = {}
        for sensor in config.sensors:
            self._build(sensor)
        self._navigator = Navigator(
            config,
            self._methods,
            centre_of_mass_m=target.centre_of_mass_m,
            alike=target.turns(exact=True),
        )
        self._state: NavigatorState = self._navigator.start(config.initial_pose)
        self._resets: SimpleQueue[ResetRequest] = SimpleQueue()
        self._silence_ns = round(config.navigator.silence_timeout_s * NANOSECONDS) + 2 * _TICK_NS
        self._passed_ns: int | None = None

    @property
    def mode(self) -> Mode:
        """State of the navigator."""
        return self._state.mode

    def _build(self, sensor: SensorInput) -> None:
        """Build a sensor's methods and load their compiled code; a LIDAR's only once its pattern is known."""
        pattern = self._patterns[sensor.name]
        if isinstance(sensor, LidarInput):
            if pattern is None:
                return
            self._methods[sensor.name] = lidar_methods(sensor, self._target, pattern)
        else:
            self._methods[sensor.name] = pmd_methods(sensor, self._target)
        warm_up(self._methods[sensor.name], self._target, pattern)

    def use_patterns(self, patterns: Mapping[str, ScanPattern]) -> None:
        """Build a LIDAR's methods anew where its latched info tells another scan pattern."""
        for name, pattern in patterns.items():
            known = self._patterns[name]
            if known is None or not known.equals(pattern):
                log.info(
                    "scan pattern of %s: %d x %d", name, pattern.elevation_rad.size, pattern.azimuth_rad.size
                )
                self._patterns[name] = pattern
                self._build(self._sensors[name])

    def request_reset(self, request: ResetRequest) -> Accepted:
        """Begin anew with the next frame, from nothing or from a given pose."""
        if request.pose is not None and request.frame_id != CHASER:
            raise ConfigurationError(
                "reset", "frame_id", f"{request.frame_id!r}: poses are taken in {CHASER!r}"
            )
        self._resets.put(request)
        return Accepted()

    def _take_resets(self) -> None:
        while True:
            try:
                request = self._resets.get_nowait()
            except Empty:
                return
            log.info("reset %s", "to a given pose" if request.pose is not None else "to nothing")
            begun = self._navigator.start(
                request.pose, covariance=request.covariance, stamp_ns=request.stamp_ns
            )
            self._state = replace(begun, shown_ns=self._state.shown_ns)

    def process(self, arrived: Arrived) -> Output:
        """Return what becomes of a frame."""
        self._take_resets()
        if arrived.measurement is None:
            return self._rejected(arrived, arrived.reason)
        if arrived.sensor not in self._methods:
            return self._rejected(arrived, "no scan pattern: neither lidar info nor configuration tells it")
        before = self._state.mode
        self._state, output = self._navigator.step(self._state, arrived.measurement)
        self._log_change(before, output)
        return output

    def tick(self, now_ns: int) -> Output | None:
        """Let time pass without a frame."""
        self._take_resets()
        before = self._state.mode
        self._state, output = self._navigator.step(self._state, Tick(now_ns))
        if output is None or before == self._state.mode:
            return None
        self._log_change(before, output)
        return output

    def let_time_pass(self, until_ns: int) -> Iterator[Output]:
        """Tick from the newest frame's stamp up to another frame's, where no wall clock does it.

        A run in lockstep and a replay pass the same times, whatever the machine is busy with.
        """
        if self._passed_ns is not None:
            last_ns = min(until_ns, self._passed_ns + self._silence_ns)  # later ticks say nothing new
            for now_ns in range(self._passed_ns + _TICK_NS, last_ns, _TICK_NS):
                if output := self.tick(now_ns):
                    yield output
        self._passed_ns = max(until_ns, self._passed_ns or 0)

    def _rejected(self, arrived: Arrived, reason: str) -> Output:
        status = EstimatorStatus(
            stamp_ns=arrived.stamp_ns,
            frame_id=CHASER,
            mode=self._state.mode,
            sensor=arrived.sensor,
            reason=reason,
        )
        return Output(status, None)

    def _log_change(self, before: Mode, output: Output) -> None:
        if output.status.mode != before:
            log.info(
                "%s -> %s%s",
                before.name,
                output.status.mode.name,
                f": {output.status.reason}" * bool(output.status.reason),
            )
