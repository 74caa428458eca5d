"""Whether the newest estimate may be used now: a flag and the age of the newest measurement.

An estimate is valid while it is supported by measurements that are new, accepted and not contradicted, and
while its own covariance is below the alert limit. The validity is published with each estimate, and between
estimates by a thread, so that a busy main loop cannot delay it. Its age also grows while this process stands
still, since the target moves on (decision 80).
"""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median
from threading import Event, Lock, Thread
from types import TracebackType
from typing import Self

from rpod_estimator.frame_reader import FROZEN_REPEATS, Arrived
from rpod_estimator.inputs.book import AT_ONCE
from rpod_pose.navigation.sensors.streams import PERIODS
from rpod_pose.navigation.state import Output
from rpod_runtime import BusClock
from rpod_runtime.clock import Clock
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.topics import CHASER
from rpod_schemas.types import EstimateValidity, Mode

BEACON_S = 0.1
"""Longest time between two messages."""
_MARGIN_S = 1e-3


@dataclass
class _Sensor:
    arrival_s: float | None = None
    """Arrival of its last frame."""
    new_s: float | None = None
    """Arrival of its last frame that was accepted, with content that differs from the frame before."""
    gaps_s: deque[float] = field(default_factory=lambda: deque(maxlen=9))
    """Times between its last frames."""
    contradiction: str = ""
    """Reason why its last frame must not be used at all; empty if it may be used."""
    repeats: int = 0
    """Number of frames since its last new one that are identical to it."""

    def deadline_s(self, stale_after_s: float) -> float:
        """Return the time up to which its last measurement supports an estimate."""
        return float("-inf") if self.new_s is None else self.new_s + self._allowed_s(stale_after_s)

    def sends(self, now_s: float, stale_after_s: float) -> bool:
        """Return whether it still sends frames; the last frame of a silent sensor does not matter."""
        return self.arrival_s is not None and now_s <= self.arrival_s + self._allowed_s(stale_after_s)

    def _allowed_s(self, stale_after_s: float) -> float:
        return max(stale_after_s, PERIODS * median(self.gaps_s or [0.0]))


class Validity:
    """Keeps the data from which the newest estimate's validity follows. Safe to use from several threads.

    Args:
        stale_after_s: longest time without a new measurement, unless the sensor's own period is longer.
    """

    def __init__(self, stale_after_s: float) -> None:
        self._stale_after_s = stale_after_s
        self._sensors: dict[str, _Sensor] = {}
        self._mode = Mode.ACQUIRING
        self._unusable = ""
        self._stamp_ns = self._measured_ns = 0
        self.newest_ns = 0
        """Newest stamp of a result or a frame so far."""
        self._lock = Lock()

    def take(self, output: Output, arrived: Arrived | None = None, *, now_s: float) -> None:
        """Note a result of the estimator and its frame, which arrived at ``now_s``."""
        with self._lock:
            self._mode = output.status.mode
            self.newest_ns = max(self.newest_ns, _newest_ns(output, arrived))
            if output.odometry is not None:
                if output.odometry.stamp_ns < self._stamp_ns:  # a reset after a clock was set back
                    self._measured_ns = 0
                self._stamp_ns, self._unusable = output.odometry.stamp_ns, output.unusable
            if arrived is not None:
                self._take_frame(output, arrived, now_s)

    def _take_frame(self, output: Output, arrived: Arrived, now_s: float) -> None:
        sensor = self._sensors.setdefault(arrived.sensor, _Sensor())
        if sensor.arrival_s is not None:
            sensor.gaps_s.append(max(now_s - sensor.arrival_s, 0.0))
        sensor.arrival_s, sensor.repeats = now_s, arrived.repeats
        sensor.contradiction = output.status.reason if arrived.refused in AT_ONCE else ""
        if output.status.accepted and not arrived.repeats:
            sensor.new_s = now_s
            self._measured_ns = max(self._measured_ns, arrived.stamp_ns)

    def at(self, now_s: float, now_ns: int) -> EstimateValidity:
        """Return the validity of the newest estimate at a time, given in monotonic and in stamp time."""
        with self._lock:
            reason = self._reason(now_s)
            age_s = (now_ns - self._measured_ns) / NANOSECONDS if self._measured_ns else float("nan")
            return EstimateValidity(
                stamp_ns=self._stamp_ns, frame_id=CHASER, valid=not reason, age_s=age_s, reason=reason
            )

    def deadline_s(self) -> float:
        """Return the time at which the estimate becomes invalid without another measurement."""
        with self._lock:
            return self._deadline_s()

    def _deadline_s(self) -> float:
        return max((each.deadline_s(self._stale_after_s) for each in self._sensors.values()), default=0.0)

    def _reason(self, now_s: float) -> str:
        if not self._mode.has_track:
            return f"the target is not tracked: {self._mode.name}"
        for name, sensor in self._sensors.items():
            if not sensor.sends(now_s, self._stale_after_s):
                continue
            if sensor.contradiction:
                return f"{name}: {sensor.contradiction}"
            if sensor.repeats >= FROZEN_REPEATS and now_s > sensor.deadline_s(self._stale_after_s):
                return f"{name} is frozen: its last {sensor.repeats + 1} frames are identical"
        if now_s <= self._deadline_s():
            return self._unusable
        accepted_s = [each.new_s for each in self._sensors.values() if each.new_s is not None]
        if not accepted_s:
            return "no measurement was accepted yet"
        return f"no new measurement was accepted for {now_s - max(accepted_s):.2f} s"


class Beacon:
    """Publishes the validity between the estimates: at once when it ends, otherwise every ``BEACON_S``.

    If time comes from the bus, it is silent, because with a separate thread two runs would differ. Then the
    validity is published with each result, at the newest stamp of the results. The clock's time is not used:
    a message of the clock may arrive after a frame that was published later, so that runs would differ.

    Args:
        validity: the validity to publish.
        publish: function that publishes it.
        clock: time of the stamps.
    """

    def __init__(self, validity: Validity, publish: Callable[[EstimateValidity], None], clock: Clock) -> None:
        self._validity, self._publish, self._clock = validity, publish, clock
        self.is_silent = isinstance(clock, BusClock)
        """Whether time comes from the bus."""
        self._stop = Event()
        self._thread = Thread(target=self._run, name="validity", daemon=True)

    def now_s(self) -> float:
        """Return the time from which the age of measurements follows: monotonic, or that of the results."""
        return self._validity.newest_ns / NANOSECONDS if self.is_silent else time.monotonic()

    def take(self, output: Output, arrived: Arrived | None) -> EstimateValidity:
        """Note a result and its frame, from whose arrival its age counts; return its validity."""
        if self.is_silent:
            now_s = max(self._validity.newest_ns, _newest_ns(output, arrived)) / NANOSECONDS
        else:
            now_s = arrived.arrival_s if arrived is not None else self.now_s()
        self._validity.take(output, arrived, now_s=now_s)
        return self.current()

    def current(self) -> EstimateValidity:
        """Return the validity now."""
        now_ns = self._validity.newest_ns if self.is_silent else self._clock.now_ns()
        return self._validity.at(self.now_s(), now_ns)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()
        if not self.is_silent:
            ended = {"valid": False, "reason": "the estimator has ended"}
            self._publish(self.current().model_copy(update=ended))

    def _run(self) -> None:
        while not self.is_silent and not self._stop.wait(self._wait_s()):
            self._publish(self.current())

    def _wait_s(self) -> float:
        """Return the time to the next message, s; it is earlier if the estimate becomes invalid before."""
        left_s = self._validity.deadline_s() - self.now_s()
        return min(BEACON_S, left_s + _MARGIN_S) if left_s > 0.0 else BEACON_S


def _newest_ns(output: Output, arrived: Arrived | None) -> int:
    """Return the newest stamp of a result and its frame, ns; 0 without one."""
    odometry_ns = output.odometry.stamp_ns if output.odometry is not None else 0
    return max(odometry_ns, arrived.stamp_ns if arrived is not None else 0)
