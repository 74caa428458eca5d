"""A run, read from its log in one pass: all data that are scored and drawn.

The data are stored by the minute (``StreamedRun``), so that a run of any length is scored minute by
minute in bounded memory; ``read_run`` returns all of it at once.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_analysis.errors import FramesDifferError, NoEstimatesError
from rpod_analysis.log import Log
from rpod_analysis.log.accounting import Account
from rpod_analysis.log.sensors import Sensor, find_sensors
from rpod_analysis.log.targets import logged_targets
from rpod_analysis.scoring.integrity import Integrities
from rpod_analysis.scoring.row_store import BLOCK_NS, Row
from rpod_analysis.scoring.run_reader import Found, Reader
from rpod_analysis.scoring.score import MAX_TRUTH_GAP_NS, BoolArray, Errors, IntArray, Track, find_errors
from rpod_schemas.arrays import FloatArray
from rpod_schemas.topics import STATUS
from rpod_schemas.types import Mode
from rpod_target import NO_SYMMETRY, Equivalence, TargetError, load_equivalence

_NO_COVARIANCE = bytes(8 * 36)

DEFAULT_PREFIX = STATUS.name.split("/")[0]


@dataclass(frozen=True, eq=False)
class Statuses:
    """The estimator's status of N frames, in the order of their stamps; each array has the shape (N,)."""

    stamp_ns: IntArray
    """Stamps of the frames, ns of UTC."""
    number: IntArray
    """Place in the order of arrival, in which the navigator passed through the modes."""
    mode: IntArray
    """Values of ``Mode``."""
    source: IntArray
    """Values of ``Source``."""
    accepted: BoolArray
    """Whether the measurement was accepted."""
    nis: FloatArray
    """Normalised innovation squared, with the degrees of freedom of the NEES; NaN without a comparison."""
    processing_s: FloatArray
    """Time from the arrival of the frame's last part to publication, s; NaN if unknown."""
    sensor: NDArray[np.str_]
    """Name of the frame's sensor; empty for a prediction without a frame."""
    reason: NDArray[np.str_]
    """Reason for which the measurement was rejected; empty if it was accepted."""
    lost_before: BoolArray
    """Whether the track was lost between the status before and this one."""

    def __len__(self) -> int:
        return self.stamp_ns.size

    def by_arrival(self) -> tuple[IntArray, IntArray]:
        """Return the places in the order of arrival, and the newest stamp up to each, ns, both shape (N,).

        A scan arrives after images with newer stamps. The mode that it brings about begins after theirs.
        """
        order = np.argsort(self.number)
        return order, np.maximum.accumulate(self.stamp_ns[order])


@dataclass(frozen=True, eq=False)
class SensorFrames:
    """Stamps and times of arrival of a sensor's frames, each shape (N,)."""

    stamp_ns: IntArray
    """Stamps, ns of UTC."""
    log_ns: IntArray
    """Arrival at the logger, ns of UTC."""


@dataclass(frozen=True, eq=False)
class Run:
    """A run, or a minute of it, in the order of the stamps."""

    start_ns: int
    """First stamp of truth and estimator, of the whole run."""
    end_ns: int
    """Last stamp of truth and estimator, of the whole run."""
    truth: Track
    """Samples of the truth."""
    estimates: Track
    """The N published estimates."""
    covariance: FloatArray
    """Covariance of (dp, dtheta) in chaser axes, shape (N, 6, 6)."""
    latency_s: FloatArray
    """Time from the estimates' stamps to the first publication at each stamp, shape (N,); NaN if the run does
    not use the wall clock. A late frame of another sensor improves the newest estimate, which is published
    again at its stamp."""
    tracked: BoolArray
    """Whether an estimate's frame was in TRACKING or COASTING, shape (N,)."""
    sensor_of: NDArray[np.str_]
    """Sensor whose frame gave each estimate, shape (N,); empty if unknown."""
    R_chaser_sensor: Rotation
    """Attitude of that sensor for each estimate, N rotations."""
    T_truth: RigidTransform
    """Truth at the estimates' stamps, N poses; not valid for estimates that are not scored."""
    errors: Errors
    statuses: Statuses
    integrity: Integrities
    sensors: dict[str, Sensor]
    frames: dict[str, SensorFrames]
    """Frames by sensor."""
    account: Account
    """Counts of the whole run."""

    @property
    def duration_s(self) -> float:
        """Time from the first to the last stamp of truth and estimator."""
        return (self.end_ns - self.start_ns) * 1e-9

    def seconds(self, stamp_ns: IntArray) -> FloatArray:
        """Return stamps, ns of UTC, as seconds from the start of the run, in the same shape."""
        return (stamp_ns - self.start_ns) * np.float64(1e-9)


class StreamedRun:
    """A run of any length, minute by minute; the rows of a long run are on disk."""

    def __init__(self, found: Found, alike: Equivalence = NO_SYMMETRY) -> None:
        self._found, self._alike = found, alike
        stores = (found.truth, found.estimates, found.statuses)
        self.minutes: list[int] = sorted(
            {minute for store in (*stores, found.frames) for minute in store.minutes}
        )
        """Minutes of UTC for which there are data."""
        self.start_ns = min(store.first_ns for store in stores if store.first_ns is not None)
        """First stamp of truth and estimator."""
        self.end_ns = max(store.last_ns for store in stores if store.last_ns is not None)
        """Last stamp of truth and estimator."""
        self.sensors, self.account = found.sensors, found.account
        self.mounts = found.mounts
        """Newest differences between the mounts of two sensors."""
        self.faults = tuple(sorted(found.faults.values(), key=lambda fault: fault.identity[::-1]))
        """Faults that were injected, in the order of their beginning."""
        self.status_topic = found.status_topic
        self.clock = found.clock
        """Whether time comes from the topic ``clock``."""

    @property
    def prefix(self) -> str:
        """First part of the estimator's topics."""
        return self.status_topic.split("/")[0]

    @property
    def duration_s(self) -> float:
        """Time from the first to the last stamp of truth and estimator."""
        return (self.end_ns - self.start_ns) * 1e-9

    def __iter__(self) -> Iterator[Run]:
        """Iterate over the minutes, in the order of time."""
        return (self.minute(minute) for minute in self.minutes)

    def at(self, stamp_ns: int) -> Run:
        """Return the minute that contains a stamp."""
        return self.minute(stamp_ns // BLOCK_NS)

    def minute(self, minute: int) -> Run:
        """Return a minute, with the same scores as within the whole run."""
        return self._build([minute], self._truth_around(minute), self._status_before(minute))

    def whole(self) -> Run:
        """Return all minutes as one run."""
        return self._build(self.minutes, [], [])

    def _truth_around(self, minute: int) -> list[Row]:
        """Return the truth just before and after a minute, for the interpolation at its ends."""
        start_ns = minute * BLOCK_NS
        before = [row for row in self._found.truth.rows(minute - 1) if row[0] >= start_ns - MAX_TRUTH_GAP_NS]
        end_ns = start_ns + BLOCK_NS + MAX_TRUTH_GAP_NS
        return before + [row for row in self._found.truth.rows(minute + 1) if row[0] < end_ns]

    def _status_before(self, minute: int) -> list[Row]:
        earlier = [other for other in self._found.statuses.minutes if other < minute]
        return self._found.statuses.rows(earlier[-1])[-1:] if earlier else []

    def _build(self, minutes: list[int], truth_around: list[Row], status_before: list[Row]) -> Run:
        found = self._found
        truth_rows, estimate_rows, status_rows, frame_rows = (
            [row for minute in minutes for row in store.rows(minute)]
            for store in (found.truth, found.estimates, found.statuses, found.frames)
        )
        truth, estimates, statuses = _truth(truth_rows), _track(estimate_rows), _statuses(status_rows)
        tracked, sensor_of = _behind(estimates, _statuses(status_before + status_rows))
        covariance = np.frombuffer(b"".join(row[2] for row in estimate_rows)).reshape(-1, 6, 6)
        R_chaser_sensor = _sensor_axes(sensor_of, self.sensors)
        errors, T_truth = find_errors(
            estimates,
            _truth(sorted(truth_rows + truth_around, key=lambda row: row[0])) if truth_around else truth,
            covariance=covariance,
            R_chaser_sensor=R_chaser_sensor,
            alike=self._alike,
        )
        first = np.searchsorted(estimates.stamp_ns, estimates.stamp_ns)  # rows are in the order of stamps
        delay_ns = np.array([row[3] for row in estimate_rows], np.int64)[first] - estimates.stamp_ns
        return Run(
            start_ns=self.start_ns,
            end_ns=self.end_ns,
            truth=truth,
            estimates=estimates,
            covariance=covariance,
            latency_s=np.full(len(estimates), np.nan) if found.clock else delay_ns * np.float64(1e-9),
            tracked=tracked,
            sensor_of=sensor_of,
            R_chaser_sensor=R_chaser_sensor,
            T_truth=T_truth,
            errors=errors,
            statuses=statuses,
            integrity=Integrities.of(
                [row for minute in minutes for row in found.integrity.rows(minute)], self.start_ns
            ),
            sensors=self.sensors,
            frames={name: _sensor_frames(name, frame_rows) for name in self.sensors},
            account=self.account,
        )


def read_run(
    log: Log,
    *,
    prefix: str | None = None,
    sensors: dict[str, Sensor] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Run:
    """Read a whole log and compare its estimates with its truth; arguments as for ``stream_run``."""
    return stream_run(log, prefix=prefix, sensors=sensors, start_ns=start_ns, end_ns=end_ns).whole()


def stream_run(
    log: Log,
    *,
    prefix: str | None = None,
    sensors: dict[str, Sensor] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> StreamedRun:
    """Read a log in memory that does not grow with its length.

    Args:
        log: log with estimates.
        prefix: first part of the estimates' topics, necessary if the log has several; found by default.
        sensors: sensors in whose axes errors are given, necessary if their data are not in the log; found by
            default.
        start_ns: time of arrival from which messages are read.
        end_ns: time of arrival before which messages are read.

    Raises:
        NoEstimatesError: there is neither an estimate nor a status in the log.
        FramesDifferError: truth and estimates are given in different frames of reference.
    """
    prefix = prefix or estimate_prefix(log)
    reader = Reader(log, prefix, find_sensors(log) if sensors is None else sensors)
    for logged in log.messages(start_ns=start_ns, end_ns=end_ns):
        reader.take(logged)
    found = reader.found
    if not found.estimates.count and not found.statuses.count:
        raise NoEstimatesError(log.paths[0], prefix)
    if len(found.parents) > 1:
        raise FramesDifferError(log.paths[0], found.parents)
    return StreamedRun(found, _alike(log))


def _alike(log: Log) -> Equivalence:
    """Return which attitudes of the log's target are equivalent; none if its file is not on this machine."""
    name = logged_targets(log).shown
    try:
        return load_equivalence(name) if name else NO_SYMMETRY
    except TargetError:  # the report tells it
        return NO_SYMMETRY


def estimate_prefix(log: Log) -> str:
    """Return the first part of the estimator's topics; ``estimate`` if there are several or none."""
    suffix = STATUS.name.removeprefix(DEFAULT_PREFIX)
    found = [name for name, info in log.topics.items() if info.type == STATUS.type and name.endswith(suffix)]
    return found[0].removesuffix(suffix) if len(found) == 1 else DEFAULT_PREFIX


def _track(rows: list[Row]) -> Track:
    poses = np.array([row[1] for row in rows], np.float64).reshape(-1, 7)
    return Track(
        np.array([row[0] for row in rows], np.int64),
        RigidTransform.from_components(poses[:, :3], Rotation.from_quat(poses[:, 3:])),
    )


def _truth(rows: list[Row]) -> Track:
    track = _track(rows)
    if not any(row[2] for row in rows):
        return track
    covariance = np.frombuffer(b"".join(row[2] or _NO_COVARIANCE for row in rows)).reshape(-1, 6, 6)
    return replace(track, covariance=covariance)


def _statuses(rows: list[Row]) -> Statuses:
    columns = list(zip(*rows, strict=True)) if rows else [()] * 10
    stamp_ns, number, mode, source, accepted, nis, processing_s, sensor, reason, lost_before = columns
    return Statuses(
        stamp_ns=np.array(stamp_ns, np.int64),
        number=np.array(number, np.int64),
        mode=np.array(mode, np.int64),
        source=np.array(source, np.int64),
        accepted=np.array(accepted, bool),
        nis=np.array(nis, np.float64),
        processing_s=np.array(processing_s, np.float64),
        sensor=np.array(sensor, np.str_),
        reason=np.array(reason, np.str_),
        lost_before=np.array(lost_before, bool),
    )


def _behind(estimates: Track, statuses: Statuses) -> tuple[BoolArray, NDArray[np.str_]]:
    """Return whether estimates are of tracked frames, and their sensors, by the last status up to each.

    An estimate without an earlier status counts as tracked, with an unknown sensor.
    """
    last = np.searchsorted(statuses.stamp_ns, estimates.stamp_ns, side="right") - 1
    if not len(statuses):
        return last < 0, np.full(len(estimates), "", np.str_)
    return (
        (last < 0) | np.isin(statuses.mode[last], (Mode.TRACKING, Mode.COASTING)),
        np.where(last >= 0, statuses.sensor[last], ""),
    )


def _sensor_frames(sensor: str, rows: list[Row]) -> SensorFrames:
    table = np.array([(row[0], row[2]) for row in rows if row[1] == sensor], np.int64).reshape(-1, 2)
    return SensorFrames(table[:, 0], table[:, 1])


def _sensor_axes(sensor_of: NDArray[np.str_], sensors: dict[str, Sensor]) -> Rotation:
    """Return the attitude of the sensor whose frame gave each estimate.

    If the sensor is unknown, it is the attitude of the only sensor; if the mount is unknown, that of the
    chaser.
    """
    quaternions = np.tile((0.0, 0.0, 0.0, 1.0), (sensor_of.size, 1))
    for sensor in sensors.values():
        if sensor.T_chaser_sensor is not None:
            mine = sensor_of == sensor.name if len(sensors) > 1 else slice(None)
            quaternions[mine] = sensor.T_chaser_sensor.rotation.as_quat()
    return Rotation.from_quat(quaternions)
