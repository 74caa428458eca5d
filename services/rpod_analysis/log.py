"""Opening a log: topics, messages and metadata of one or several MCAP files (ICD section 5).

Nothing is read before it is asked for; a slice of time costs only the chunks that it touches.
Several files are the parts of one run: they are read as one log, in the order of time.
"""

import json
import struct
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from mcap.exceptions import McapError
from mcap.reader import McapReader, make_reader
from mcap.summary import Summary
from scipy.spatial.transform import RigidTransform

from rpod_analysis.errors import DamagedLogError, NoLogError, NotMcapError, TruncatedLogError
from rpod_schemas.cdr import decode
from rpod_schemas.logs import CONFIGURATION, COUNTS, TopicCount
from rpod_schemas.messages import read_odometry, read_status, read_transforms
from rpod_schemas.topics import ESTIMATE, STATUS, TF_STATIC, TOPICS, Topic
from rpod_schemas.types import EstimatorStatus, Odometry

_MAGIC = b"\x89MCAP0\r\n"
_DAMAGE = (McapError, RuntimeError, ValueError, KeyError, struct.error, EOFError)
"""What the MCAP reader and the decompression raise on damaged bytes."""


@dataclass(frozen=True, slots=True)
class Logged:
    """One message of a log."""

    topic: str
    type: str
    """ROS 2 type, as ``sensor_msgs/msg/Image``."""
    log_ns: int
    """Arrival at the logger."""
    publish_ns: int
    """Source stamp of the attachment."""
    sequence: int
    """Sequence number of the attachment."""
    payload: bytes

    def decode(self) -> Any:
        """Return the ROS message; raises ``MessageRejectedError``."""
        return decode(self.payload, self.type)


@dataclass(frozen=True)
class TopicInfo:
    """A topic of a log."""

    type: str
    count: int
    """Messages in the log's files."""


@dataclass(frozen=True)
class _Part:
    """One file of a log."""

    path: Path
    reader: McapReader
    summary: Summary

    @property
    def start_ns(self) -> int:
        """Arrival of the first message."""
        return self.summary.statistics.message_start_time if self.summary.statistics else 0


def open_log(path: Path | str, *more: Path | str) -> "Log":
    """Open a log, or the parts of one.

    Raises:
        AnalysisError: a file is missing, no MCAP, or truncated.
    """
    return Log(path, *more)


class Log:
    """A log that is open; close it by ``with``."""

    def __init__(self, *paths: Path | str) -> None:
        with ExitStack() as stack:
            parts = [_open_part(Path(path), stack) for path in paths]
            self._parts = sorted(parts, key=lambda part: part.start_ns)
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    @property
    def paths(self) -> tuple[Path, ...]:
        """The log's files, in the order of time."""
        return tuple(part.path for part in self._parts)

    # --- what is there ---

    @cached_property
    def topics(self) -> dict[str, TopicInfo]:
        """Topics by name, without the ROS namespace."""
        counts: dict[str, TopicInfo] = {}
        for part in self._parts:
            messages = part.summary.statistics.channel_message_counts if part.summary.statistics else {}
            for channel in part.summary.channels.values():
                name = self._name(channel.topic)
                before = counts[name].count if name in counts else 0
                schema = part.summary.schemas.get(channel.schema_id)
                type_name = schema.name if schema else ""
                counts[name] = TopicInfo(type_name, before + messages.get(channel.id, 0))
        return dict(sorted(counts.items()))

    @cached_property
    def configuration(self) -> dict[str, dict[str, Any]]:
        """The resolved configuration of every service, by instance."""
        return {name: json.loads(text) for name, text in self.metadata(CONFIGURATION).items()}

    def metadata(self, record: str) -> dict[str, str]:
        """Return a metadata record, empty where there is none; what was written later counts."""
        values: dict[str, str] = {}
        for part in self._parts:
            values |= _metadata_of(part, record)
        return values

    @cached_property
    def counts(self) -> dict[str, TopicCount]:
        """The logger's account by topic, over all files that were closed."""
        totals: dict[str, Counter[str]] = defaultdict(Counter)
        for part in self._parts:
            for topic, text in _metadata_of(part, COUNTS).items():
                totals[self._name(topic)].update(json.loads(text))
        return {topic: TopicCount(**counter) for topic, counter in totals.items()}

    @cached_property
    def extrinsics(self) -> dict[str, tuple[str, RigidTransform]]:
        """Parent and T_parent_child of every static transform, by child; the last one counts."""
        transforms: dict[str, tuple[str, RigidTransform]] = {}
        for logged in self.messages(TF_STATIC):
            for _, parent, child, T_parent_child in read_transforms(logged.decode()):
                transforms[child] = parent, T_parent_child
        return transforms

    # --- messages ---

    def messages(
        self, *topics: Topic | str, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Logged]:
        """Iterate over messages in the order of arrival.

        Args:
            topics: of which topics; of all where none is named.
            start_ns: arrival of the first message.
            end_ns: all messages arrived before this.

        Raises:
            DamagedLogError: the file cannot be read there.
        """
        names = {topic.name if isinstance(topic, Topic) else topic for topic in topics}
        latched: set[tuple[str, int, int]] = set()  # each file opens with the latched messages again
        for part in self._parts:
            for logged in self._messages_of(part, names, start_ns, end_ns):
                if is_latched(logged.topic):
                    identity = logged.topic, logged.sequence, logged.publish_ns
                    if identity in latched:
                        continue
                    latched.add(identity)
                yield logged

    def _messages_of(
        self, part: _Part, names: set[str], start_ns: int | None, end_ns: int | None
    ) -> Iterator[Logged]:
        channels = {
            channel.topic: self._name(channel.topic)
            for channel in part.summary.channels.values()
            if not names or self._name(channel.topic) in names
        }
        if not channels:
            return
        found = part.reader.iter_messages(list(channels), starting_at=start_ns, ending_before=end_ns)
        while True:
            with _reading(part.path):
                item = next(found, None)
            if item is None:
                return
            schema, channel, message = item
            yield Logged(
                channels[channel.topic],
                schema.name if schema else "",
                message.log_time,
                message.publish_time,
                message.sequence,
                message.data,
            )

    def odometry(
        self, topic: Topic | str = ESTIMATE, *, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Odometry]:
        """Iterate over a nav_msgs/Odometry topic."""
        for logged in self.messages(topic, start_ns=start_ns, end_ns=end_ns):
            yield read_odometry(logged.decode())

    def statuses(
        self, topic: Topic | str = STATUS, *, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[EstimatorStatus]:
        """Iterate over the estimator's status."""
        for logged in self.messages(topic, start_ns=start_ns, end_ns=end_ns):
            yield read_status(logged.decode())

    def _name(self, channel_topic: str) -> str:
        """Return a topic's name as the ICD writes it: no leading slash, no namespace."""
        return channel_topic.removeprefix("/").removeprefix(self._namespace)

    @cached_property
    def _namespace(self) -> str:
        for service in self.configuration.values():
            if namespace := service.get("bus", {}).get("namespace"):
                return f"{namespace}/"
        return ""


def _metadata_of(part: _Part, record: str) -> dict[str, str]:
    values: dict[str, str] = {}
    with _reading(part.path):
        for item in part.reader.iter_metadata():
            values |= item.metadata if item.name == record else {}
    return values


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Turn what damaged bytes provoke into the error that says so."""
    try:
        yield
    except _DAMAGE as error:
        raise DamagedLogError(path, " ".join(str(error).split()) or type(error).__name__) from error


def is_latched(name: str) -> bool:
    """Return whether the ICD has a topic latched."""
    kind = name.split("/", 1)[-1]
    return any(
        topic.latched and (topic.name == name or topic.name in (f"<camera>/{kind}", f"<lidar>/{kind}"))
        for topic in TOPICS
    )


def _open_part(path: Path, stack: ExitStack) -> _Part:
    try:
        stream = stack.enter_context(path.open("rb"))
        _check_ends(path, stream)
    except OSError as error:
        raise NoLogError(path, (error.strerror or str(error)).lower()) from error
    with _reading(path):
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
    if summary is None:
        raise TruncatedLogError(path)
    return _Part(path, reader, summary)


def _check_ends(path: Path, stream: IO[bytes]) -> None:
    """An MCAP file begins and, once it was closed, ends with the same eight bytes."""
    if stream.read(len(_MAGIC)) != _MAGIC:
        raise NotMcapError(path)
    size = stream.seek(0, 2)
    stream.seek(max(size - len(_MAGIC), len(_MAGIC)))
    if stream.read() != _MAGIC:
        raise TruncatedLogError(path)
    stream.seek(0)
