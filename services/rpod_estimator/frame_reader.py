"""Conversion of messages into measurements, without a bus; the daemon and the replay of a log both use it.

Parts of a frame are identified by topic and by the stamp in their first bytes. Only frames that are processed
are decoded.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from rpod_estimator.inputs.beside import ImagesBeside
from rpod_estimator.inputs.earlier_frames import EarlierFrames
from rpod_estimator.inputs.repeated_lines import RepeatedLines
from rpod_estimator.setup_check import Setup, SetupCheck
from rpod_pose.measurement import Measurement
from rpod_pose.pmd.camera_check import CameraCheck
from rpod_runtime import Received
from rpod_runtime.assembler import Assembled, Assembler
from rpod_runtime.delivery.holders import Announcements, Peer
from rpod_runtime.delivery.kept import KeptMessages
from rpod_runtime.errors import ExtrinsicsError
from rpod_runtime.frames import PartRejectedError, SensorReader, assembler_of, open_reader
from rpod_runtime.sensor_data.end_watch import Last, last_of
from rpod_runtime.sensor_data.extrinsics import Extrinsics
from rpod_schemas.config.sensor import SensorInput
from rpod_schemas.config.source import SourceConfig
from rpod_schemas.errors import ConfigurationError, MessageRejectedError, Reason
from rpod_schemas.messages import read_transforms
from rpod_schemas.rmw.cdr import STAMP_END, peek_stamp
from rpod_schemas.sensors import SensorKind, sensor_kind
from rpod_schemas.topics import TF_STATIC, Topic
from rpod_schemas.types import Camera, SensorFrame, SensorInfo

_IN_TIME = frozenset({
    Reason.FROZEN, Reason.NOT_FINITE, Reason.EMPTY, Reason.WRONG_SIZE, Reason.MALFORMED, Reason.OTHER_CAMERA,
    Reason.OTHER_SETUP, Reason.UNKNOWN_FRAME,
})  # fmt: skip
"""Reasons to refuse a frame whose stamp is right but which has no usable measurement."""
_MOST_OBLONG = 0.03
"""Largest relative difference of the two focal lengths of a camera with square pixels: in the calibration of
the 2018 paper it is 1.3 %."""
_MOST_DARK = 200
"""Largest number of measured pixels with which an amplitude of zeros may be right, because they are faint."""
FROZEN_REPEATS = 2
"""Least number of repetitions of a frame's content from a frozen sensor. A driver may send one frame twice:
the second one is refused, since it was not measured at its stamp, but is no alert."""


@dataclass(frozen=True)
class Arrived:
    """A frame for the navigator, or the reason why it cannot be used."""

    sensor: str
    stamp_ns: int
    arrival_s: float
    """Arrival of the last part, monotonic clock."""
    measurement: Measurement | None
    reason: str = ""
    refused: str = ""
    """Kind of the reason, a ``Reason``; empty if there is a measurement."""
    repeats: int = 0
    """Number of successive frames, up to this one, whose content equals that of the previous frame."""
    again: int = 0
    """Number of successive frames, up to this one, whose content equals that of an earlier frame."""
    defect: str = ""
    """Defect of a usable frame's data, with its remedy; empty if there is none."""
    hint: str = ""
    """Possible cause, from the sensor's last frames, why they are refused; empty if there is none."""
    evidence: Mapping[str, float] = field(default_factory=dict)
    """In a replay: evidence in the status of this frame in the live run."""
    clock_moved_s: float = 0.0
    """Change of the sensor's stamps against their arrival, s, if the frame is refused for it, or is the first
    one that is used in spite of it; else 0."""

    @property
    def is_frozen(self) -> bool:
        """Whether its sensor is frozen or sends earlier frames again, and does not only send one twice."""
        return self.again > FROZEN_REPEATS or (
            self.refused == Reason.FROZEN and self.repeats >= FROZEN_REPEATS
        )

    @property
    def came_in_time(self) -> bool:
        """Whether the stamp is usable, although the frame may have no measurement."""
        return self.measurement is not None or self.refused in _IN_TIME

    @classmethod
    def unusable(
        cls, sensor: str, stamp_ns: int, error: MessageRejectedError, arrival_s: float = 0.0
    ) -> Self:
        """Return a frame that is refused for the reason of an error."""
        return cls(sensor, stamp_ns, arrival_s, None, str(error), error.reason)


@dataclass
class _Sensor:
    """One sensor: the reader of its frames, and data of its last frame."""

    source: SourceConfig
    kind: SensorKind
    reader: SensorReader
    info: Received | None = None
    """Info message with which frames are read."""
    leader: Peer | None = None
    """Publisher of the last frame."""
    frame_id: str | None = None
    """Frame of reference of the last frame."""
    content: memoryview = field(default_factory=lambda: memoryview(b""))
    """Bytes of the leading part of the last frame, after its stamp."""
    repeats: int = 0
    """Number of successive frames with this content, after the first one."""
    lines: RepeatedLines = field(default_factory=RepeatedLines)
    """Lines of its last frames."""
    earlier: EarlierFrames = field(default_factory=EarlierFrames)
    """Its earlier frames."""
    beside: ImagesBeside = field(default_factory=ImagesBeside)
    """Where its amplitude lies beside its depth."""


class FrameReader:
    """Assembles frames of the configured sensors, and reads measurements from them."""

    def __init__(self, sensors: Sequence[SensorInput]) -> None:
        self.latched: tuple[Topic, ...] = (TF_STATIC,)
        """Latched topics, whose messages go to ``learn``."""
        self.streams: tuple[Topic, ...] = ()
        """Topics of the parts of frames, whose messages go to the ``assemblers``."""
        self.parts: dict[str, tuple[str, str]] = {}
        """Sensor and part, by the name of the stream topic."""
        self.assemblers: dict[str, Assembler[Received]] = {}
        """Assembler of each sensor, by sensor name."""
        self.leading: dict[str, str] = {}
        """Leading part of the frames, by sensor name; a frame is reported as refused when this part is
        refused."""
        self._sensors: dict[str, _Sensor] = {}
        self.pinned = False
        """Whether the setups of sensors must not change, because a track uses them."""
        self._infos: Announcements[Received] = Announcements()
        self._setups = SetupCheck()
        self._extrinsics = Extrinsics({sensor.name: sensor.T_chaser_sensor for sensor in sensors})
        self._cameras = CameraCheck()
        for sensor in sensors:
            self._expect(sensor)

    def _expect(self, sensor: SensorInput) -> None:
        kind = sensor_kind(sensor.kind)
        if kind.info is not None:
            self.latched += (kind.info.of(sensor.name),)
        reader = open_reader(kind, sensor.source)
        reader.assume(sensor.configured_info)
        self._sensors[sensor.name] = _Sensor(sensor.source, kind, reader)
        self.assemblers[sensor.name] = assembler_of(kind, sensor.source)
        self.leading[sensor.name] = kind.leading_part
        for name, topic in kind.part_topics(sensor.name, sensor.source).items():
            if other := self.parts.get(topic.name):
                problem = f"the topic {topic.name!r} is already the {other[1]} of the sensor {other[0]}"
                remedy = "give each sensor its own topics, or its driver's namespace"
                raise ConfigurationError(sensor.name, "source.topics", f"{problem}; {remedy}")
            self.streams += (topic,)
            self.parts[topic.name] = sensor.name, name

    @property
    def infos(self) -> Mapping[str, Any]:
        """Newest info message of each sensor, by sensor name; None if a sensor has sent none.

        If the info of a pinned sensor has changed, this is the previous one.
        """
        infos = {name: sensor.reader.newest_info for name, sensor in self._sensors.items()}
        return {name: self._setups.info(name, info) if self.pinned else info for name, info in infos.items()}

    def learn(self, received: Received) -> None:
        """Store the content of a latched message. Raises ``MessageRejectedError``."""
        topic = received.topic
        if topic.name == TF_STATIC.name:
            for _, parent, child, pose in read_transforms(received.decode()):
                self._extrinsics.set(parent, child, pose, received.peer)
            return
        sensor = topic.name.split("/", 1)[0]
        open_reader(self._sensors[sensor].kind).learn(received.decode())  # refuses what cannot be used
        self._infos.put(topic.name, received.peer, received)
        self._inform(sensor, received.session)

    def _inform(self, sensor: str, session: str) -> None:
        """Give a sensor's reader the info that applies to the frames of a session."""
        known = self._sensors[sensor]
        info = known.kind.info
        found = self._infos.of(info.of(sensor).name, session) if info is not None else None
        if found is not None and found[1] is not known.info:
            known.info = found[1]
            known.reader.learn(found[1].decode())

    def leave(self, session: str, topic: Topic) -> None:
        """Note that the publisher of a session on a latched topic is gone."""
        if topic.name == TF_STATIC.name:
            self._extrinsics.announced.leave(lambda _: True, session)
        else:
            self._infos.leave(lambda name: name == topic.name, session)

    def forget(self, *, keep: str = "") -> None:
        """Accept the present setups of the sensors; with ``keep``, those that this session publishes."""
        self._setups.forget()
        self._cameras = CameraCheck()
        self._extrinsics.announced.release(keep=keep)
        self._infos.release(keep=keep)

    @property
    def rivals(self) -> Iterator[tuple[str, Peer, Peer]]:
        """Publishers that contradict each other about a mount or info: name, used one, and another one."""
        for frame_id in (sensor.frame_id for sensor in self._sensors.values()):
            if frame_id is not None and (found := self._extrinsics.rivals(frame_id)):
                yield f"{TF_STATIC.name} of {frame_id}", *found
        for name in self._infos.names:
            given = self._infos.rivals(name)
            for other, received in given[1:]:
                if received.payload[STAMP_END:] != given[0][1].payload[STAMP_END:]:
                    yield name, given[0][0], other

    @property
    def peers(self) -> Iterator[Peer]:
        """Publishers of mounts and infos."""
        yield from self._extrinsics.announced.peers
        yield from self._infos.peers

    def lasting(self, topic: Topic) -> bool:
        """Return whether a message of a stream is valid until the next one arrives, whatever its age."""
        sensor, part = self.parts[topic.name]
        return part in self.assemblers[sensor].lasting

    def due(self, sensor: str, kept: KeptMessages, leading: Received) -> Iterator[tuple[str, Received]]:
        """Yield kept messages that apply from a frame of a sensor on, each with the name of its part."""
        for topic, (owner, part) in self.parts.items():
            lasts = owner == sensor and part in self.assemblers[sensor].lasting
            if lasts and (message := kept.due(topic, leading)) is not None:
                yield part, message

    def stamp_ns(self, sensor: str, received: Received) -> int:
        """Return the middle of exposure or scan of a part, ns of UTC. Raises ``MessageRejectedError``."""
        return peek_stamp(received.payload) + self._sensors[sensor].source.correction_ns

    def measurement(self, sensor: str, frame: Assembled[Received]) -> Measurement:
        """Return the decoded and checked frame with its mount. Raises ``PartRejectedError``."""
        leading, known = frame.parts[self.leading[sensor]], self._sensors[sensor]
        self._succeed(sensor, leading.peer)
        self._inform(sensor, leading.session)
        data = known.reader.read(frame)
        if data.lens is not None:
            self._check_camera(sensor, data.lens, frame.parts.get("camera_info", leading))
        known.frame_id = data.frame_id
        try:
            mount = self._extrinsics.mount(sensor, data.frame_id, leading.session)
        except ExtrinsicsError as error:
            rejection = MessageRejectedError(Reason.UNKNOWN_FRAME, str(error))
            raise PartRejectedError(leading, rejection) from error
        try:
            setup = Setup(mount, known.reader.stated_info)
            self._setups.check(sensor, setup, source=leading.peer, pinned=self.pinned)
        except MessageRejectedError as rejection:
            raise PartRejectedError(leading, rejection) from rejection
        return Measurement(sensor, data, known.source.boresight_mount(mount))

    def _succeed(self, sensor: str, leader: Peer) -> None:
        """Note the publisher of a sensor's frames.

        Messages of rmw_zenoh name no session, so it is unknown which mount and info come from the publisher
        of the frames. When another publisher takes over, the previous mount and info may no longer apply, and
        the newest ones are used. While a target is tracked, they are compared with the previous ones.
        """
        known = self._sensors[sensor]
        before, known.leader = known.leader or leader, leader
        if before == leader or before.session:
            return
        if known.frame_id is not None:
            self._extrinsics.leave_unknown(known.frame_id)
        if (info := known.kind.info) is not None:
            self._infos.leave(lambda name: name == info.of(sensor).name, "")

    def arrived(self, sensor: str, frame: Assembled[Received], arrival_s: float) -> Arrived:
        """Return a frame with its measurement, or with the reason why it is refused.

        Raises:
            PartRejectedError: a part cannot be used.
        """
        measurement = self.measurement(sensor, frame)
        repeats = self.repeats(sensor, frame)
        known, shows = self._sensors[sensor], _shows_something(measurement.data)
        torn, is_torn = ("", False) if repeats else known.lines.found(measurement.data)
        again = known.earlier.text if shows else ""
        if is_torn:
            error = MessageRejectedError(Reason.FROZEN, again or torn)
            arrived = Arrived.unusable(sensor, frame.stamp_ns, error, arrival_s)
        elif not repeats or not shows:
            reader = known.reader
            defect, unused = _defect(measurement.data)
            if unused in type(measurement.data).model_fields:
                measurement = replace(measurement, data=measurement.data.model_copy(update={unused: None}))
            lens = measurement.data.lens
            oblong = "" if lens is None else _oblong(lens)
            beside = known.beside.found(measurement.data)
            told = (again or torn, beside, _negative(measurement.data), defect, oblong, reader.inconsistency)
            defect = "; ".join(filter(None, told))
            arrived = Arrived(sensor, frame.stamp_ns, arrival_s, measurement, defect=defect, hint=reader.hint)
        else:
            text = f"the last {repeats + 1} frames are identical to the bit; restart the sensor's driver"
            error = MessageRejectedError(Reason.FROZEN, text)
            arrived = Arrived.unusable(sensor, frame.stamp_ns, error, arrival_s)
        return replace(arrived, repeats=repeats, again=known.earlier.in_a_row if shows else 0)

    def last(self, sensor: str, data: SensorFrame) -> Last:
        """Return the time of a frame's last measurement, from its points or from the stated duration."""
        known = self._sensors[sensor]
        info = known.reader.newest_info
        stated_s = info.duration_s if isinstance(info, SensorInfo) else 0.0
        return last_of(data, stated_s or known.source.duration_s)

    def repeats(self, sensor: str, frame: Assembled[Received]) -> int:
        """Return the number of successive frames with identical content; noise is never identical."""
        content = frame.parts[self.leading[sensor]].payload[STAMP_END:]
        known = self._sensors[sensor]
        same = np.array_equal(np.asarray(content), np.asarray(known.content))
        known.content, known.repeats = content, known.repeats + 1 if same else 0
        known.earlier.take(content)
        return known.repeats

    def _check_camera(self, sensor: str, camera: Camera, received: Received) -> None:
        try:
            self._cameras.check(sensor, camera, pinned=self.pinned)
        except MessageRejectedError as rejection:
            raise PartRejectedError(received, rejection) from rejection


def _shows_something(data: SensorFrame) -> bool:
    """Return whether a frame has a measured pixel or a return; empty frames are always identical."""
    if data.images:
        return bool(np.isfinite(data.images[0].values).any())
    return len(data.returns_m) > 0


def _negative(data: SensorFrame) -> str:
    """Return how many distances are negative; empty if they have one value, which may stand for none."""
    if not data.images:
        return ""
    values = data.images[0].values
    negative = values[np.isfinite(values) & (values < 0.0)]
    if not negative.size or (negative == negative[0]).all():
        return ""
    return (
        f"{negative.size} pixels have a negative {data.images[0].title}, down to {negative.min():.3g} m, and "
        "are not used; correct its driver, which should send NaN where nothing is measured"
    )


def _oblong(lens: Camera) -> str:
    """Return how the focal lengths of a lens differ, if its pixels are far from square; otherwise empty."""
    ratio = lens.fx / lens.fy - 1.0
    if abs(ratio) <= _MOST_OBLONG:
        return ""
    return (
        f"fx of its camera_info is {abs(ratio):.1%} {'above' if ratio > 0.0 else 'below'} fy, and pixels are "
        "square in nearly all cameras; calibrate the lens, or let the driver scale fx and fy as the image. "
        "Nothing is wrong if the pixels are oblong"
    )


def _defect(data: SensorFrame) -> tuple[str, str]:
    """Return the defect of an image, besides the leading one, with one value in all pixels, and its name.

    The name is empty if the image is used. An image of zeros may be right if few pixels have a range: the
    target may be too faint for the encoding. With any other constant value, the frame is used without the
    image.
    """
    for image in data.images[1:]:
        first = image.values.flat[0]
        if not (image.values[0] == first).all() or not (image.values == first).all():
            continue
        found = f"all pixels of its {image.title} are {first}"
        if first > 0:
            return f"{found}, so it is not used; correct its driver, or leave that topic out", image.title
        leading = data.images[0].values
        measured = int(np.count_nonzero(np.isfinite(leading) & (leading > 0)))
        if measured > _MOST_DARK:
            text = f"{found} although {measured} pixels have a range; correct its driver, or expose longer"
            return text, ""
    return "", ""
