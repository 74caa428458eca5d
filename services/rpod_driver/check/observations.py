"""The messages of a sensor: a few data of each, and some whole frames.

A camera sends a gigabyte in half a minute. So only stamp, arrival, number and digest of each message are
kept, and one pair of successive frames in 0.7 s.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import blake2b
from itertools import count
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_driver.check.surface import Surface
from rpod_runtime import Received
from rpod_runtime.assembler import Assembled, GivenUp
from rpod_runtime.delivery.holders import Peer
from rpod_runtime.frames import assembler_of, open_reader
from rpod_runtime.sensor_data.extrinsics import Extrinsics
from rpod_schemas.config.source import SourceConfig
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import (
    NANOSECONDS,
    is_measured,
    read_camera,
    read_diagnostics,
    read_image,
    read_odometry,
    read_points,
    read_status,
    read_transforms,
)
from rpod_schemas.rmw.cdr import STAMP_END, peek_stamp
from rpod_schemas.sensors import sensor_kind
from rpod_schemas.topics import DIAGNOSTICS, ESTIMATE, STATUS, TF_STATIC, TRUTH, Topic
from rpod_schemas.types import Camera, Diagnostic, EstimatorStatus, Float32Array, Odometry, SensorFrame

_PAIR_NS = 700_000_000
"""Time from one kept pair of frames to the next."""
_MOST_FRAMES = 120
_MOST_MESSAGES = 200_000
ICD = SourceConfig()


class Heard(NamedTuple):
    """One message of a sensor."""

    part: str
    stamp_ns: int
    """Stamp, corrected by the source."""
    arrival_ns: int
    sent_ns: int
    """Time at which the publisher sent it, by its own clock."""
    sequence: int
    peer: Peer
    size: int
    """Size of the payload, bytes."""
    digest: bytes
    """Digest of the content without the stamp."""


class Kept(NamedTuple):
    """One frame that was kept as a whole."""

    number: int
    """Number of the frame since the start; successive frames have successive numbers."""
    frame: SensorFrame
    raw: NDArray[Any]
    """Leading message as it was sent: pixels of an image, or points, shape (..., 3)."""
    encoding: str
    """Encoding of an image; empty for points."""


class Offer(NamedTuple):
    """Quality of service of one publisher, by its liveliness token."""

    qos: str
    """As rmw_zenoh writes it."""
    session: str
    """Zenoh identity of its session; empty if it is unknown."""


@dataclass(frozen=True)
class Options:
    """Facts about a sensor that its messages do not contain."""

    rate_hz: float | None = None
    """Nominal rate."""
    source: SourceConfig = ICD
    """Topics, stamps and units of its driver."""
    surface: Surface | None = None
    """Surface of the target, for comparisons with truth and with a second sensor."""
    against: str | None = None
    """Prefix of an estimate that follows the target with another sensor; None if there is none."""


@dataclass
class Observations:
    """Everything that the check judges."""

    kind: str
    name: str
    options: Options
    started_ns: int = 0
    ended_ns: int = 0
    heard: list[Heard] = field(default_factory=list)
    kept: list[Kept] = field(default_factory=list)
    refused: list[tuple[Reason, str]] = field(default_factory=list)
    refused_beside: list[tuple[Reason, str]] = field(default_factory=list)
    """Messages that cannot be read on topics that are not the sensor's own, such as truth and mounts."""
    """Reasons why frames could not be read."""
    frames: int = 0
    """Number of complete frames."""
    given_up: list[GivenUp] = field(default_factory=list)
    raw_middle_m: list[float] = field(default_factory=list)
    """Median distance in the leading message of refused frames, as it was sent."""
    newest_info: Any = None
    """Properties of the sensor as it states them, or as its frames show them."""
    infos: list[tuple[Peer, Any]] = field(default_factory=list)
    cameras: list[Camera] = field(default_factory=list)
    """Lenses, one for each change."""
    mounts: list[tuple[Peer, str, str, Any]] = field(default_factory=list)
    frame_ids: set[str] = field(default_factory=set)
    qos: dict[str, set[Offer]] = field(default_factory=dict)
    """Qualities of service in the publishers' tokens, by topic; also of topics of other nodes."""
    truth: list[Odometry] = field(default_factory=list)
    estimates: list[Odometry] = field(default_factory=list)
    """Poses by the estimator of another sensor."""
    statuses: list[EstimatorStatus] = field(default_factory=list)
    """Statuses of this estimator."""
    diagnostics: dict[str, Diagnostic] = field(default_factory=dict)

    @property
    def leading(self) -> str:
        """Leading part of the frames."""
        return sensor_kind(self.kind).leading_part

    def of_part(self, part: str) -> list[Heard]:
        """Return the messages of a part, of the publisher that sent most, in the order of its numbers."""
        messages = [heard for heard in self.heard if heard.part == part]
        peers = [heard.peer for heard in messages]
        if not peers:
            return []
        most = max(dict.fromkeys(peers), key=peers.count)
        return sorted((heard for heard in messages if heard.peer == most), key=lambda heard: heard.sequence)

    @cached_property
    def leads(self) -> list[Heard]:
        """Messages of the leading part."""
        return self.of_part(self.leading)

    @property
    def period_s(self) -> float:
        """Median time between two stamps, s; NaN for fewer than three frames."""
        steps = np.diff([heard.stamp_ns for heard in self.leads])
        steps = steps[steps > 0]
        return float(np.median(steps)) / NANOSECONDS if steps.size >= 2 else float("nan")

    @property
    def info(self) -> Any:
        """Last info of the sensor; None if none came."""
        return self.infos[-1][1] if self.infos else None

    @property
    def sessions(self) -> set[str]:
        """Sessions of the publishers of the frames."""
        return {heard.peer.session for heard in self.heard}

    def extrinsics(self) -> Extrinsics:
        """Return the mounts that were announced."""
        extrinsics = Extrinsics({})
        for peer, parent, child, pose in self.mounts:
            extrinsics.set(parent, child, pose, peer)
        return extrinsics


class Observer:
    """Takes messages of a sensor, in the order of their arrival; single-threaded."""

    def __init__(self, kind: str, name: str, options: Options | None = None) -> None:
        options = options or Options()
        self.seen = Observations(kind, name, options)
        sensor = sensor_kind(kind)
        self._source = options.source
        topics = sensor.part_topics(name, options.source)
        self._parts = {topic.name: part for part, topic in topics.items()}
        info = sensor.info
        self.info = None if info is None else info.of(name)
        self.streams: tuple[Topic, ...] = tuple(topics.values())
        """Topics of the parts of frames."""
        self.latched: tuple[Topic, ...] = (TF_STATIC, *((self.info,) if self.info else ()))
        """Latched topics."""
        against = options.against
        self._estimate = ESTIMATE.under(against).name if against else ""
        self._status = STATUS.under(against).name if against else ""
        estimator = (ESTIMATE.under(against), STATUS.under(against)) if against else ()
        self.others: tuple[Topic, ...] = (TRUTH, DIAGNOSTICS, *estimator)
        """Topics of others, for comparison."""
        self._assembler = assembler_of(sensor, options.source)
        self._reader = open_reader(sensor, options.source)
        self._numbers = count()
        self._pair: tuple[int, int] = (-10, -(10**18))
        self._truth_ns = 0

    def take(self, received: Received) -> None:
        """Take a message of any of the topics."""
        name = received.topic.name
        try:
            if name in self._parts:
                self._take_part(self._parts[name], received)
            elif name == TF_STATIC.name:
                for _, parent, child, pose in read_transforms(received.decode()):
                    self.seen.mounts.append((received.peer, parent, child, pose))
            elif name == TRUTH.name:
                self._take_truth(received)
            elif name == self._estimate:
                self.seen.estimates.append(read_odometry(received.decode()))
            elif name == self._status:
                self.seen.statuses.append(read_status(received.decode()))
            elif name == DIAGNOSTICS.name:
                self.seen.diagnostics |= {each.name: each for each in read_diagnostics(received.decode())}
            elif self.info is not None and name == self.info.name:
                self._reader.learn(received.decode())
                self.seen.infos.append((received.peer, self._reader.newest_info))
        except MessageRejectedError as error:
            own = name in self._parts or (self.info is not None and name == self.info.name)
            refused = self.seen.refused if own else self.seen.refused_beside
            refused.append((error.reason, f"{name}: {error.text}"))

    def take_tokens(self, tokens: Iterable[tuple[str, str, str]]) -> None:
        """Take topic, quality of service and session of publishers' tokens, of all nodes on the bus."""
        for topic, qos, session in tokens:
            self.seen.qos.setdefault(topic, set()).add(Offer(qos, session))

    def _take_truth(self, received: Received) -> None:
        stamp_ns = peek_stamp(received.payload)
        if stamp_ns - self._truth_ns >= NANOSECONDS // 120:
            self._truth_ns = stamp_ns
            self.seen.truth.append(read_odometry(received.decode()))

    def _take_part(self, part: str, received: Received) -> None:
        seen = self.seen
        stamp_ns = peek_stamp(received.payload) + self._source.correction_ns
        digest = blake2b(received.payload[STAMP_END:], digest_size=8).digest()
        attachment = received.attachment
        seen.started_ns = seen.started_ns or received.arrival_ns
        seen.ended_ns = max(seen.ended_ns, received.arrival_ns)
        if len(seen.heard) < _MOST_MESSAGES:
            seen.heard.append(
                Heard(
                    part, stamp_ns, received.arrival_ns, attachment.stamp_ns, attachment.sequence,
                    received.peer, len(received.payload), digest,
                )
            )  # fmt: skip
        if part == "camera_info":
            camera = read_camera(received.decode())
            if not seen.cameras or not same_lens(seen.cameras[-1], camera):
                seen.cameras.append(camera)
        for frame in self._assembler.add(part, stamp_ns, received):
            self._take_frame(frame)
        seen.given_up = (seen.given_up + self._assembler.take_given_up())[-1000:]

    def _take_frame(self, frame: Assembled[Received]) -> None:
        number = next(self._numbers)
        self.seen.frames += 1
        leading = frame.parts[self.seen.leading]
        first, since_ns = self._pair
        starts = leading.arrival_ns - since_ns >= _PAIR_NS
        if starts:
            self._pair = number, leading.arrival_ns
        elif number != first + 1:
            return
        if len(self.seen.kept) >= _MOST_FRAMES:
            return
        raw, encoding = np.zeros(0), ""
        try:
            raw, encoding = _raw(leading)
            read = self._reader.read(frame)
        except MessageRejectedError as error:
            self.seen.refused.append((error.reason, error.text))
            if raw.size:
                self.seen.raw_middle_m.append(middle_m(raw, encoding, self._source.depth_unit_m))
            return
        self.seen.frame_ids.add(read.frame_id)
        self.seen.kept.append(Kept(number, read, raw, encoding))

    def end(self, now_ns: int) -> Observations:
        """Return the observations up to now."""
        for frame in self._assembler.release():
            self._take_frame(frame)
        self.seen.ended_ns = max(self.seen.ended_ns, now_ns)
        self.seen.newest_info = self._reader.newest_info
        return self.seen


def same_lens(first: Camera, second: Camera) -> bool:
    """Return whether two lenses are the same."""
    return all(np.array_equal(getattr(first, name), getattr(second, name)) for name in Camera.model_fields)


def _raw(received: Received) -> tuple[NDArray[Any], str]:
    message = received.decode()
    if hasattr(message, "fields"):
        fields = read_points(message)
        return np.stack([fields[axis] for axis in "xyz"], axis=-1), ""
    if hasattr(message, "step"):
        return read_image(message), str(message.encoding)
    return np.zeros(0), str(getattr(message, "format", ""))


def middle_m(raw: NDArray[Any], encoding: str, unit_m: float | None = None) -> float:
    """Return the median distance in a leading message as it was sent, m; NaN if there is none.

    ``unit_m`` is the length of one unit of a depth image, where it is not that of its encoding.
    """
    if encoding in ("16UC1", "mono16"):
        values: NDArray[Any] = raw[is_measured(raw)] * (unit_m or 1e-3)
    elif encoding:
        values = raw[np.isfinite(raw) & (raw > 0)] if raw.dtype.kind == "f" else np.zeros(0)
        values = values * (unit_m or 1.0)
    else:
        values = ranges_m(raw)
    return float(np.median(values)) if values.size else float("nan")


def ranges_m(points_m: NDArray[Any]) -> Float32Array:
    """Return the ranges of the returns among points, shape (..., 3), m."""
    range_m = np.linalg.norm(points_m.reshape(-1, 3), axis=1)
    kept: Float32Array = range_m[np.isfinite(range_m) & (range_m > 0.0)]
    return kept
