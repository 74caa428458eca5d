"""Frames of a rosbag2 or MCAP file, assembled and read as the estimator would."""

import logging
from collections import Counter
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import Reader, ReaderError

from rpod_driver.adapters.replay.config import ReplayConfig
from rpod_driver.errors import RecordingError
from rpod_runtime.delivery.inbox import Received
from rpod_runtime.frames import PartRejectedError, assembler_of, open_reader
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.rmw.cdr import decode, peek_stamp
from rpod_schemas.rmw.wire import UNNUMBERED
from rpod_schemas.sensors import sensor_kind
from rpod_schemas.topics import Topic
from rpod_schemas.types import SensorFrame

log = logging.getLogger(__name__)


class Bag:
    """The messages of one sensor in a recording."""

    def __init__(self, config: ReplayConfig, path: Path) -> None:
        """Open the file and find the topics. Raises ``RecordingError``."""
        self._path, self._source = path, config.device.source
        self._kind = sensor_kind(config.kind)
        self._parts = self._kind.part_topics(config.name, self._source)
        self._name = config.name
        self._left_out: Counter[str] = Counter()
        self._check()

    def info(self) -> Any:
        """Return the sensor's latched info, None if there is none."""
        if self._kind.info is None:
            return None
        topic, reader = self._kind.info.of(self._name), open_reader(self._kind, self._source)
        for _, payload in islice(self._messages({"info": topic}), 1):
            reader.learn(decode(payload, topic.type))
        return reader.newest_info

    def frames(self) -> Iterator[SensorFrame]:
        """Yield the frames in their order; report at the end which were left out."""
        reader = open_reader(self._kind, self._source)
        assembler = assembler_of(self._kind, self._source)
        self._left_out.clear()
        for name, payload in self._messages(self._parts):
            try:
                stamp_ns = peek_stamp(payload) + self._source.correction_ns
            except MessageRejectedError as error:
                self._left_out[str(error)] += 1
                continue
            part = Received(self._parts[name], "", memoryview(payload), UNNUMBERED, stamp_ns)
            for frame in assembler.add(name, stamp_ns, part):
                yield from self._read(reader, frame)
        for frame in assembler.release():
            yield from self._read(reader, frame)
        if assembler.incomplete:
            needed = ", ".join(topic.name for topic in self._parts.values())
            self._left_out[f"incomplete: not all of {needed} within {self._source.pair_within_s:g} s"] += (
                assembler.incomplete
            )
        for reason, count in self._left_out.items():
            log.warning("%s: %d frames of %s were left out: %s", self._name, count, self._path, reason)

    def _read(self, reader: Any, frame: Any) -> Iterator[SensorFrame]:
        try:
            yield reader.read(frame)
        except PartRejectedError as error:
            self._left_out[f"{error.topic}: {error.text}"] += 1

    def _messages(self, topics: dict[str, Topic]) -> Iterator[tuple[str, bytes]]:
        """Yield the messages of topics with the topics' keys, in the order of their recording."""
        names = {(topic.name, topic.type): name for name, topic in topics.items()}
        with Reader(self._path) as reader:
            wanted = [each for each in reader.connections if _key(each) in names]
            if not wanted:
                return
            for connection, _, payload in reader.messages(wanted):
                yield names[_key(connection)], payload

    def _check(self) -> None:
        try:
            with Reader(self._path) as reader:
                held = {_key(connection) for connection in reader.connections}
        except (ReaderError, OSError) as error:
            reason = f"is no rosbag2 or MCAP file ({error}); correct device.bag"
            raise RecordingError(self._path, reason) from error
        needed = self._kind.required | self._kind.lasting
        lacking = [topic for name, topic in self._parts.items() if name in needed]
        lacking = [topic for topic in lacking if (topic.name, topic.type) not in held]
        if lacking:
            topics = ", ".join(sorted(f"{name} ({kind})" for name, kind in held)) or "nothing"
            raise RecordingError(
                self._path,
                f"lacks {lacking[0].name} ({lacking[0].type}), holds {topics}; correct name, or name the "
                "topics in device.source.topics",
            )


def _key(connection: Any) -> tuple[str, str]:
    return connection.topic.lstrip("/"), connection.msgtype
