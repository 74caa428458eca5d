"""A run as its log tells it: everything that is scored and drawn, read in one pass."""

from array import array
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_analysis.accounting import Account
from rpod_analysis.errors import FramesDifferError, NoEstimatesError
from rpod_analysis.log import Log, Logged
from rpod_analysis.score import BoolArray, Errors, IntArray, Track, find_errors
from rpod_analysis.sensors import Sensor, find_sensors
from rpod_schemas.arrays import FloatArray
from rpod_schemas.cdr import peek_stamp
from rpod_schemas.messages import read_diagnostics, read_stamp
from rpod_schemas.topics import CLOCK, DEPTH, DIAGNOSTICS, ESTIMATE, POINTS, STATUS, TRUTH
from rpod_schemas.types import Diagnostic, Health, Mode

DEFAULT_PREFIX = STATUS.name.split("/")[0]


@dataclass(frozen=True, eq=False)
class Statuses:
    """What the estimator said of N frames, in the order of their stamps."""

    stamp_ns: IntArray
    mode: IntArray
    accepted: BoolArray
    processing_s: FloatArray
    sensor: NDArray[np.str_]
    reason: NDArray[np.str_]

    def __len__(self) -> int:
        return self.stamp_ns.size


@dataclass(frozen=True, eq=False)
class SensorFrames:
    """When the frames of a sensor were taken and when they came, each shape (N,)."""

    stamp_ns: IntArray
    log_ns: IntArray


@dataclass(frozen=True, eq=False)
class Run:
    """A run, read from its log."""

    truth: Track
    estimates: Track
    covariance: FloatArray
    """Of (dp, dtheta) in chaser axes, shape (N, 6, 6)."""
    latency_s: FloatArray
    """Stamp to publication of the estimates, shape (N,); NaN where the clock is not the wall's."""
    tracked: BoolArray
    """Whether an estimate's frame was in TRACKING, shape (N,)."""
    sensor_of: NDArray[np.str_]
    """The sensor behind each estimate, shape (N,); empty where unknown."""
    R_chaser_sensor: Rotation
    """Attitude of that sensor, N of them."""
    errors: Errors
    statuses: Statuses
    sensors: dict[str, Sensor]
    frames: dict[str, SensorFrames]
    """By sensor."""
    account: Account
    alarms: tuple[Diagnostic, ...]
    """Diagnostics of level ERROR."""
    status_topic: str

    @property
    def start_ns(self) -> int:
        """First stamp of truth and estimator."""
        return min(int(stamps.min()) for stamps in self._stamps)

    @property
    def duration_s(self) -> float:
        """From the first to the last stamp of truth and estimator."""
        return (max(int(stamps.max()) for stamps in self._stamps) - self.start_ns) * 1e-9

    @property
    def _stamps(self) -> list[IntArray]:
        stamps = (self.truth.stamp_ns, self.estimates.stamp_ns, self.statuses.stamp_ns)
        return [stamp_ns for stamp_ns in stamps if stamp_ns.size]

    def seconds(self, stamp_ns: IntArray) -> FloatArray:
        """Return stamps as seconds from the start of the run."""
        return (stamp_ns - self.start_ns) * np.float64(1e-9)


def read_run(
    log: Log,
    *,
    prefix: str | None = None,
    sensors: dict[str, Sensor] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Run:
    """Read a log and score its estimates against its truth.

    Args:
        log: with estimates.
        prefix: first part of the estimates' topics, where the log has several; found where left out.
        sensors: in whose axes errors are told, where the log has not their data; found where left out.
        start_ns: arrival of the first message.
        end_ns: all messages arrived before this.

    Raises:
        NoEstimatesError: there is neither an estimate nor a status in the log.
        FramesDifferError: truth and estimates are of different frames.
    """
    prefix = prefix or estimate_prefix(log)
    sensors = find_sensors(log) if sensors is None else sensors
    reader = _Reader(prefix, sensors)
    for logged in log.messages(start_ns=start_ns, end_ns=end_ns):
        reader.take(logged)
    if not reader.estimates.rows and not reader.statuses:
        raise NoEstimatesError(log.paths[0], prefix)
    if len(reader.truth.parents | reader.estimates.parents) > 1:
        raise FramesDifferError(log.paths[0], *sorted(reader.truth.parents | reader.estimates.parents)[:2])
    return reader.run()


def estimate_prefix(log: Log) -> str:
    """Return the first part of the estimator's topics; ``estimate`` where there are several or none."""
    suffix = STATUS.name.removeprefix(DEFAULT_PREFIX)
    found = [name for name, info in log.topics.items() if info.type == STATUS.type and name.endswith(suffix)]
    return found[0].removesuffix(suffix) if len(found) == 1 else DEFAULT_PREFIX


@dataclass
class _Poses:
    """Odometry messages as bare numbers: the domain type costs ten times as much as the decoding."""

    with_covariance: bool = False
    rows: "array[float]" = field(default_factory=lambda: array("d"))
    stamps: "array[int]" = field(default_factory=lambda: array("q"))
    published: "array[int]" = field(default_factory=lambda: array("q"))
    covariances: "array[float]" = field(default_factory=lambda: array("d"))
    parents: set[str] = field(default_factory=set)

    def take(self, logged: Logged) -> None:
        message = logged.decode()
        p, q = message.pose.pose.position, message.pose.pose.orientation
        self.rows.extend((p.x, p.y, p.z, q.x, q.y, q.z, q.w))
        self.stamps.append(read_stamp(message.header))
        self.published.append(logged.publish_ns)
        if self.with_covariance:
            self.covariances.frombytes(message.pose.covariance.tobytes())
        self.parents.add(message.header.frame_id)

    def track(self) -> Track:
        rows = np.array(self.rows, np.float64).reshape(-1, 7)
        poses = RigidTransform.from_components(rows[:, :3], Rotation.from_quat(rows[:, 3:]))
        return Track(np.array(self.stamps, np.int64), poses)

    def covariance(self) -> FloatArray:
        return np.array(self.covariances, np.float64).reshape(-1, 6, 6)


class _Reader:
    """Sorts the messages of one pass by what they are for."""

    def __init__(self, prefix: str, sensors: dict[str, Sensor]) -> None:
        self.truth, self.estimates = _Poses(), _Poses(with_covariance=True)
        self.statuses: list[tuple[Any, ...]] = []
        self._sensors = sensors
        self._frames: dict[str, list[tuple[int, int]]] = defaultdict(list)
        self._account = Account()
        self._alarms: list[Diagnostic] = []
        self._clock = False
        self._status_topic = STATUS.under(prefix).name
        self._takers: dict[str, Callable[[Logged], None]] = {
            TRUTH.name: self.truth.take,
            ESTIMATE.under(prefix).name: self.estimates.take,
            self._status_topic: self._take_status,
            DIAGNOSTICS.name: self._take_diagnostics,
            CLOCK.name: self._take_clock,
        }
        for sensor in sensors.values():
            topic = (DEPTH if sensor.kind == "pmd" else POINTS).of(sensor.name)
            self._takers[topic.name] = self._frame_taker(sensor.name)

    def take(self, logged: Logged) -> None:
        self._account.take(logged)
        if taker := self._takers.get(logged.topic):
            taker(logged)

    def _take_status(self, logged: Logged) -> None:
        status = logged.decode()
        self.statuses.append(
            (
                read_stamp(status.header), status.mode, status.accepted,
                status.processing_s, status.sensor, status.reason,
            )
        )  # fmt: skip

    def _take_diagnostics(self, logged: Logged) -> None:
        for diagnostic in read_diagnostics(logged.decode()):
            self._account.hear(diagnostic)
            if diagnostic.level == Health.ERROR:
                self._alarms.append(diagnostic)

    def _take_clock(self, _: Logged) -> None:
        self._clock = True

    def _frame_taker(self, sensor: str) -> Callable[[Logged], None]:
        def take(logged: Logged) -> None:
            self._frames[sensor].append((peek_stamp(logged.payload), logged.log_ns))

        return take

    def run(self) -> Run:
        truth, estimates, statuses = self.truth.track(), self.estimates.track(), self._statuses()
        covariance = self.estimates.covariance()
        delay_ns = np.array(self.estimates.published, np.int64) - estimates.stamp_ns
        latency_s = np.full(len(estimates), np.nan) if self._clock else delay_ns * np.float64(1e-9)
        behind = _status_behind(estimates.stamp_ns, statuses)
        sensor_of = (
            np.where(behind >= 0, statuses.sensor[behind], "") if len(statuses) else _no_names(estimates)
        )
        tracked = (behind < 0) | (statuses.mode[behind] == Mode.TRACKING) if len(statuses) else behind < 0
        R_chaser_sensor = _sensor_axes(sensor_of, self._sensors)
        return Run(
            truth=truth,
            estimates=estimates,
            covariance=covariance,
            latency_s=latency_s,
            tracked=tracked,
            sensor_of=sensor_of,
            R_chaser_sensor=R_chaser_sensor,
            errors=find_errors(estimates, truth, covariance=covariance, R_chaser_sensor=R_chaser_sensor),
            statuses=statuses,
            sensors=self._sensors,
            frames={name: _sensor_frames(self._frames[name]) for name in self._sensors},
            account=self._account,
            alarms=tuple(self._alarms),
            status_topic=self._status_topic,
        )

    def _statuses(self) -> Statuses:
        rows = sorted(self.statuses, key=lambda row: row[0])
        stamp_ns, mode, accepted, processing_s, sensor, reason = (
            zip(*rows, strict=True) if rows else ((),) * 6
        )
        return Statuses(
            stamp_ns=np.array(stamp_ns, np.int64),
            mode=np.array(mode, np.int64),
            accepted=np.array(accepted, bool),
            processing_s=np.array(processing_s, np.float64),
            sensor=np.array(sensor, np.str_),
            reason=np.array(reason, np.str_),
        )


def _status_behind(stamp_ns: IntArray, statuses: Statuses) -> IntArray:
    """Return the last status at or before each stamp, -1 where there is none."""
    return np.searchsorted(statuses.stamp_ns, stamp_ns, side="right") - 1


def _no_names(estimates: Track) -> NDArray[np.str_]:
    return np.full(len(estimates), "", np.str_)


def _sensor_frames(rows: list[tuple[int, int]]) -> SensorFrames:
    table = np.array(rows, np.int64).reshape(-1, 2)
    return SensorFrames(table[:, 0], table[:, 1])


def _sensor_axes(sensor_of: NDArray[np.str_], sensors: dict[str, Sensor]) -> Rotation:
    """Return the attitude of the sensor behind each estimate.

    The only sensor's where none is named; the chaser's where the mount is not known.
    """
    quaternions = np.tile((0.0, 0.0, 0.0, 1.0), (sensor_of.size, 1))
    for sensor in sensors.values():
        if sensor.T_chaser_sensor is not None:
            mine = sensor_of == sensor.name if len(sensors) > 1 else slice(None)
            quaternions[mine] = sensor.T_chaser_sensor.rotation.as_quat()
    return Rotation.from_quat(quaternions)
