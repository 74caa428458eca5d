"""Registration of scans in a thread, while the main loop goes on with images (decision 177).

A scan takes many times longer to register than the time in which an image should be an estimate. The
prediction to its stamp does not depend on later images. So its registration is begun when it arrives. The
navigator gets the scan when the registration is there, and the tracker then returns it at once. Where the
prediction is another one by then, the tracker registers the scan again. So an estimate never depends on how
long the thread takes, but for the order of the frames, which their statuses tell a replay.
"""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from types import TracebackType
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_estimator.frame_reader import Arrived
from rpod_pose.measurement import Measurement
from rpod_pose.navigation.frames import as_of_stamp
from rpod_pose.navigation.sensors.ranges import Ranges
from rpod_pose.navigation.state import NavigatorState
from rpod_pose.ports import Methods, Registration, Tracker
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.poses import chained
from rpod_schemas.types import Mode, SensorFrame


@dataclass(frozen=True, eq=False)
class _Known:
    frame: SensorFrame
    T_sensor_target: RigidTransform
    registration: Registration

    def is_of(self, frame: SensorFrame, T_sensor_target: RigidTransform) -> bool:
        """Return whether frame and prediction are the same to the bit."""
        if not np.array_equal(self.T_sensor_target.as_matrix(), T_sensor_target.as_matrix()):
            return False
        known, other = vars(self.frame), vars(frame)
        return known.keys() == other.keys() and all(_same(known[name], other[name]) for name in known)


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return one is other or np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    return bool(one is other or one == other)


class AheadTracker:
    """A tracker that returns a registration which was made ahead: ports.Tracker.

    ``prepare`` may run in another thread, as long as nobody calls ``track`` meanwhile.
    """

    def __init__(self, tracker: Tracker[Any]) -> None:
        self._tracker = tracker
        self._known: _Known | None = None

    def prepare(self, measurement: SensorFrame, T_sensor_target: RigidTransform) -> None:
        """Register a frame, and remember the result for the next call of ``track``."""
        found = self._tracker.track(measurement, T_sensor_target)
        self._known = _Known(measurement, T_sensor_target, found)

    def track(self, measurement: Any, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration from a predicted pose, as the tracker makes it."""
        known, self._known = self._known, None
        if known is not None and known.is_of(measurement, T_sensor_target):
            return known.registration
        return self._tracker.track(measurement, T_sensor_target)


class Ahead:
    """Decides which frames are registered ahead: those of a scanning sensor that supports a track.

    Args:
        config: configuration of the estimator.
    """

    def __init__(self, config: EstimatorConfig) -> None:
        self._ranges, self._filter = Ranges(config.sensors), config.filter
        self._trackers: dict[str, AheadTracker] = {}

    def following(self, sensor: str, methods: Methods) -> Methods:
        """Return the methods of a sensor whose frames may be registered ahead if it scans."""
        if methods.deskew is None or methods.expecting is not None:
            return methods
        self._trackers[sensor] = AheadTracker(methods.tracker)
        return replace(methods, tracker=self._trackers[sensor])

    def may_pass(self, state: NavigatorState, sensor: str, stamp_ns: int) -> bool:
        """Return whether the scans before still support the track at a stamp, without the one that is held.

        Else the track would coast, or be judged by the limits of the other sensors alone.
        """
        return state.streams[sensor].supports(stamp_ns, 0.0)

    def of(
        self, state: NavigatorState, measurement: Measurement, methods: Methods
    ) -> Callable[[], None] | None:
        """Return the function that registers a frame ahead; None if it is to be processed at once."""
        tracker, history = self._trackers.get(measurement.sensor), state.history
        is_usual = state.mode is Mode.TRACKING and state.rivals is None and state.given is None
        if tracker is None or history is None or not is_usual or measurement.sensor not in state.established:
            return None
        predicted = history.at(measurement.stamp_ns, self._filter)
        if predicted is None or measurement.sensor in state.searches:
            return None
        T_sensor_chaser = measurement.T_chaser_sensor.inv()
        if self._ranges.beyond(measurement.sensor, T_sensor_chaser, predicted.T_chaser_target):
            return None
        frame = as_of_stamp(measurement, predicted, methods.deskew)
        return partial(tracker.prepare, frame, chained(T_sensor_chaser, predicted.T_chaser_target))


class Held:
    """The frame that is registered ahead at present, at most one.

    Args:
        max_delay_s: largest time by which a frame may be older than the newest one; such a frame is due.
        wake: called, in the thread, when a frame becomes due.
    """

    def __init__(self, max_delay_s: float, wake: Callable[[], None]) -> None:
        self._max_delay_ns, self._wake = round(max_delay_s * NANOSECONDS), wake
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="ahead")
        self._held: tuple[Arrived, Future[None]] | None = None

    def hold(self, arrived: Arrived, register: Callable[[], None]) -> None:
        """Hold a frame until it is registered; none is held before."""
        future = self._pool.submit(register)
        self._held = arrived, future
        future.add_done_callback(lambda _: self._wake())

    def due(self) -> Arrived | None:
        """Return the held frame if it is registered, and hold it no more."""
        return self._release() if self._held is not None and self._held[1].done() else None

    def due_before(self, arrived: Arrived, may_pass: Callable[[Arrived, str], bool]) -> Arrived | None:
        """Return the held frame, registered, if a frame must come after it, and hold it no more.

        Frames of its sensor must, those so new that it would be too old after them, and those that may not
        pass a frame of this sensor, by its name, for another reason.
        """
        if self._held is None:
            return None
        held, future = self._held
        is_near = arrived.stamp_ns - held.stamp_ns < self._max_delay_ns
        passes = arrived.sensor != held.sensor and is_near and not future.done()
        return None if passes and may_pass(arrived, held.sensor) else self._release()

    def rest(self) -> Arrived | None:
        """Return the held frame, registered, and hold it no more; None if none is held."""
        return None if self._held is None else self._release()

    @property
    def is_free(self) -> bool:
        """Whether no frame is held."""
        return self._held is None

    def _release(self) -> Arrived:
        assert self._held is not None  # noqa: S101 - checked by the callers
        (arrived, future), self._held = self._held, None
        future.result()
        return arrived

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pool.shutdown()
