"""State of the view: poses of the last seconds, and messages that have not been drawn yet.

Messages come from the bus or from a log. The parts of frames are identified by topic and stamp. Only the
newest complete frame of each sensor is decoded, and only when it is drawn.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from scipy.spatial.transform import RigidTransform

from rpod_runtime import Received
from rpod_runtime.assembler import Assembled, Assembler, NewestFrames
from rpod_runtime.errors import ExtrinsicsError
from rpod_runtime.frames import PartRejectedError, SensorReader, assembler_of, open_reader
from rpod_runtime.sensor_data.extrinsics import Extrinsics
from rpod_schemas.arrays import FloatArray
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import (
    read_diagnostics,
    read_integrity,
    read_odometry,
    read_status,
    read_transforms,
)
from rpod_schemas.poses import pose_error
from rpod_schemas.rmw.cdr import NANOSECONDS, peek_stamp
from rpod_schemas.sensors import SensorKind, sensor_kinds
from rpod_schemas.topics import DIAGNOSTICS, ESTIMATE, INTEGRITY, STATUS, TARGET, TF, TF_STATIC, TRUTH, Topic
from rpod_schemas.types import Diagnostic, EstimatorStatus, Health, Integrity, Odometry, SensorFrame
from rpod_target import Equivalence
from rpod_view.track import Track

Reject = Callable[[str, MessageRejectedError], None]
"""Function that is called with the topic's name for each message that cannot be used."""
_PATIENCE_NS = NANOSECONDS
"""Longest time that an estimate waits for its truth, ns."""
_ENOUGH_NS = 16_000_000
"""Shortest time between two messages of the truth that are decoded, ns."""
_MOST_WAITING = 512
_MOST_TROUBLES = 20


def sensor_topics() -> tuple[Topic, ...]:
    """Return patterns of the drawn topics of all sensors of the installed kinds."""
    parts = (part for kind in sensor_kinds() for part in kind.parts.values())
    return tuple(dict.fromkeys(part.topic.of("*") for part in parts))


def pose_topics(prefix: str) -> tuple[Topic, ...]:
    """Return the drawn topics besides frames and truth; ``prefix`` is that of the estimates."""
    estimates = (topic.under(prefix) for topic in (ESTIMATE, INTEGRITY, STATUS))
    return TF_STATIC, *estimates, DIAGNOSTICS


@dataclass(frozen=True)
class Frame:
    """A sensor's frame and the sensor's mount."""

    sensor: str
    data: SensorFrame
    T_chaser_sensor: RigidTransform | None
    """Mount of the sensor; None if it is unknown."""


@dataclass(frozen=True, eq=False)
class Scored:
    """An estimate, and its errors if the truth is known."""

    estimate: Odometry
    attitude_rad: FloatArray | None
    """Attitude error, Log(R_truth^T R_estimate), target axes, shape (3,); None if the truth is unknown."""
    position_m: FloatArray | None
    """Position error, chaser axes, shape (3,); None if the truth is unknown."""


class Scene:
    """Collects messages and returns the data to draw.

    Args:
        prefix: prefix of the estimator's topics.
        alike: attitudes of the target that no measurement distinguishes; errors are modulo these.
    """

    def __init__(self, prefix: str, alike: Equivalence) -> None:
        self._alike = alike
        self.truth = Track(gap_s=0.1, reach_s=0.1)
        self.estimates = Track(gap_s=2.5, reach_s=1.5)
        self.newest: Odometry | None = None
        """The last estimate."""
        self.status: EstimatorStatus | None = None
        """The last status."""
        self.integrity: Integrity | None = None
        """The last integrity; None from an estimator that publishes none."""
        self.troubles: dict[str, Diagnostic] = {}
        """Last diagnostic of each service whose level is not OK."""
        self._frame_ns = -1
        self._arrival_s = self._status_arrival_s = 0.0
        self._known_at_status_ns = -1
        self._estimate, self._status = ESTIMATE.under(prefix).name, STATUS.under(prefix).name
        self._integrity = INTEGRITY.under(prefix).name
        self._extrinsics = Extrinsics({})
        self._kinds = sensor_kinds()
        self._assemblers: dict[tuple[str, str], Assembler[Received]] = {}
        """Assemblers by sensor and kind: a topic may belong to several kinds, a complete frame to one
        only."""
        self._readers: dict[str, SensorReader] = {}
        self._frames: NewestFrames[Received] = NewestFrames()
        self._statuses: deque[EstimatorStatus] = deque(maxlen=_MOST_WAITING)
        self._integrities: deque[Integrity] = deque(maxlen=_MOST_WAITING)
        self._unscored: deque[Odometry] = deque(maxlen=_MOST_WAITING)

    # --- messages in ---

    def take(self, received: Received) -> None:
        """Process a message. Raises ``MessageRejectedError``."""
        name, self._arrival_s = received.topic.name, received.arrival_s
        if name == self._estimate:
            self._take_estimate(read_odometry(received.decode()))
        elif name == self._status:
            self._take_status(read_status(received.decode()))
        elif name == self._integrity:
            self.integrity = read_integrity(received.decode())
            self._integrities.append(self.integrity)
        elif name == TRUTH.name:
            self._take_truth(received)
        elif name in (TF.name, TF_STATIC.name):
            self._take_transforms(received)
        elif name == DIAGNOSTICS.name:
            self._take_diagnostics(read_diagnostics(received.decode()))
        else:
            self._take_part(received)

    def _take_status(self, status: EstimatorStatus) -> None:
        self.status = status
        self._statuses.append(status)
        self._status_arrival_s, self._known_at_status_ns = self._arrival_s, self.known_ns

    def _take_diagnostics(self, diagnostics: list[Diagnostic]) -> None:
        for diagnostic in diagnostics:
            self.troubles.pop(diagnostic.name, None)
            if diagnostic.level != Health.OK and len(self.troubles) < _MOST_TROUBLES:
                self.troubles[diagnostic.name] = diagnostic

    def _take_estimate(self, odometry: Odometry) -> None:
        self.newest = odometry
        self.estimates.add(odometry.stamp_ns, odometry.pose)
        self._unscored.append(odometry)

    def _take_truth(self, received: Received) -> None:
        since_ns = peek_stamp(received.payload) - self.truth.newest_ns
        if 0 <= since_ns < _ENOUGH_NS:
            return
        odometry = read_odometry(received.decode())
        self.truth.add(odometry.stamp_ns, odometry.pose)

    def _take_transforms(self, received: Received) -> None:
        for stamp_ns, parent, child, pose in read_transforms(received.decode()):
            if received.topic.name == TF_STATIC.name:
                self._extrinsics.set(parent, child, pose)
            elif child == TARGET:
                self.truth.add(stamp_ns, pose)

    def _take_part(self, received: Received) -> None:
        sensor = received.topic.name.partition("/")[0]
        for kind in self._kinds:
            for name, part in kind.parts.items():
                if part.topic.of(sensor) == received.topic:
                    self._assemble(sensor, kind, name, received)

    def _assemble(self, sensor: str, kind: SensorKind, part: str, received: Received) -> None:
        if (sensor, kind.name) not in self._assemblers:
            self._assemblers[sensor, kind.name] = assembler_of(kind)
        for frame in self._assemblers[sensor, kind.name].add(part, peek_stamp(received.payload), received):
            self._readers.setdefault(sensor, open_reader(kind))
            self._frames.put(sensor, frame)

    # --- data to draw ---

    @property
    def known_ns(self) -> int:
        """Newest stamp of frames, truth, estimates and statuses; -1 if there is none."""
        status_ns = self.status.stamp_ns if self.status is not None else -1
        return max(self._frame_ns, self.truth.newest_ns, self.estimates.newest_ns, status_ns)

    def silent_s(self, now_s: float | None) -> float:
        """Return the time since the last status came, s: that of the arrivals or of the stamps, the longer.

        Args:
            now_s: present time, clock of the arrivals; None stands for the last arrival.
        """
        if self.status is None:
            return 0.0
        arrivals_s = (self._arrival_s if now_s is None else now_s) - self._status_arrival_s
        return max(arrivals_s, (self.known_ns - self._known_at_status_ns) / NANOSECONDS)

    def frames(self, reject: Reject) -> Iterator[Frame]:
        """Yield the newest complete frame of each sensor that has a new, usable one."""
        while (chosen := self._frames.take()) is not None:
            try:
                frame = self._frame(*chosen)
            except PartRejectedError as error:
                reject(error.topic, error)
            else:
                yield frame

    def _frame(self, sensor: str, frame: Assembled[Received]) -> Frame:
        data = self._readers[sensor].read(frame)
        self._frame_ns = data.stamp_ns
        try:
            mount = self._extrinsics.mount(sensor, data.frame_id)
        except ExtrinsicsError:
            mount = None
        return Frame(sensor, data, mount)

    def statuses(self) -> list[EstimatorStatus]:
        """Return the statuses that arrived since the last call."""
        statuses = list(self._statuses)
        self._statuses.clear()
        return statuses

    def integrities(self) -> list[Integrity]:
        """Return the integrities that arrived since the last call."""
        integrities = list(self._integrities)
        self._integrities.clear()
        return integrities

    def estimated(self) -> list[Scored]:
        """Return the new estimates whose truth is known, or has not arrived after a second."""
        scored: list[Scored] = []
        while self._unscored:
            odometry = self._unscored[0]
            is_known = self.truth.newest_ns >= odometry.stamp_ns
            newest_ns = max(self._unscored[-1].stamp_ns, self.truth.newest_ns)
            if not is_known and self.truth.newest_ns >= 0 and newest_ns - odometry.stamp_ns < _PATIENCE_NS:
                break
            scored.append(self._scored(self._unscored.popleft()))
        return scored

    def _scored(self, odometry: Odometry) -> Scored:
        is_known = self.truth.newest_ns >= odometry.stamp_ns
        truth = self.truth.at(odometry.stamp_ns) if is_known else None
        if truth is None:
            return Scored(odometry, None, None)
        same = self._alike.nearest_pose(truth, odometry.pose)
        return Scored(odometry, *pose_error(same, odometry.pose))

    def estimate_at(self, stamp_ns: int) -> RigidTransform | None:
        """Return the estimated pose at a time, predicted beyond the last estimate; None if there is none."""
        if self.status is not None and not self.status.mode.has_track:
            return None
        return self.estimates.at(stamp_ns)
