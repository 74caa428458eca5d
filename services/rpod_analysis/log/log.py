"""Opening a log: topics, messages and metadata of one or several MCAP files (ICD section 5).

Data are read only when they are needed; for a slice of time only the chunks that overlap it are read.
Several files, or those of a folder, are the parts of one run. They are read as one log, in the order
of arrival.
"""

import heapq
import json
from collections import Counter, defaultdict, deque
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from mcap.records import Channel, Statistics
from scipy.spatial.transform import RigidTransform

from rpod_analysis.errors import LogLimitError
from rpod_analysis.log.log_file import LogFile, files_of, open_file, reading
from rpod_analysis.log.logged import Logged
from rpod_analysis.log.one_run import check_one_run
from rpod_analysis.log.unreadable import Unreadable
from rpod_schemas.errors import Reason
from rpod_schemas.logs import (
    CONFIGURATION,
    COUNTS,
    GID_METADATA,
    NUMBERS,
    PUBLISHERS,
    SESSION_METADATA,
    TopicCount,
)
from rpod_schemas.messages import read_odometry, read_status, read_transforms
from rpod_schemas.rmw.wire import GID_BYTES
from rpod_schemas.topics import ESTIMATE, STATUS, TF_STATIC, Topic, is_latched
from rpod_schemas.types import EstimatorStatus, Odometry

_MOST_LATCHED = 64
"""Largest number of latched messages of a topic, one per publisher, that a file may repeat at its
beginning."""


_FIELDS: dict[str, type] = {
    "name": str, "target": str, "prefix": str, "instance": str, "sensors": list, "bus": dict,
}  # fmt: skip
"""Types of the fields of a service's configuration that an analysis reads by their names."""


def _is_read(field: str, value: Any) -> bool:
    """Return whether a field of a configuration has the form in which an analysis reads it."""
    if field == "sensors" and isinstance(value, list):
        return all(isinstance(entry, dict) for entry in value)
    return value is None or isinstance(value, _FIELDS.get(field, object))


def _publisher(channel: Channel) -> tuple[str, str]:
    """Return gid and session of a channel's publisher; empty texts if it does not name one."""
    gid = channel.metadata.get(GID_METADATA, "")
    if len(gid) != 2 * GID_BYTES or not set(gid) <= set("0123456789abcdef"):
        return "", ""
    return gid, channel.metadata.get(SESSION_METADATA, "")


@dataclass(frozen=True)
class TopicInfo:
    """A topic of a log."""

    type: str
    count: int
    """Number of messages in the log's files."""


def open_log(path: Path | str, *more: Path | str, namespace: str = "") -> "Log":
    """Open a log: a file, a folder, or several of either that are read as one.

    Only the files' summaries are read. Logs of other programs with the same topics, such as rosbag2's, work
    too.

    Args:
        path: MCAP file, or a folder of them. In a folder a recovered log replaces the damaged one, and
            replays are left out.
        more: further files or folders.
        namespace: ROS namespace of the topics, if the configuration in the log does not contain it.

    Raises:
        AnalysisError: a file is missing, truncated, or not an MCAP file, or files are of different runs.
    """
    return Log(path, *more, namespace=namespace)


def _by_time(part: LogFile) -> tuple[bool, int]:
    """Return the key by which the files of a run are sorted; files without messages are the last ones."""
    return part.statistics.message_count == 0, part.statistics.message_end_time


class Log:
    """An open log; use it in a ``with`` statement, which closes it."""

    def __init__(self, *paths: Path | str, namespace: str = "") -> None:
        self.unreadable = Unreadable()
        """Messages that could not be read so far, by any reader of this log."""
        self._given_namespace = namespace.strip("/")
        with ExitStack() as stack:
            files = [file for path in paths for file in files_of(Path(path))]
            parts = [open_file(file, stack) for file in files]
            # Sorted by their ends: a part may begin with latched messages older than the part before it.
            self._parts = sorted(parts, key=_by_time)
            check_one_run(self._parts)
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

    @property
    def files(self) -> tuple[LogFile, ...]:
        """The open files, in the order of time."""
        return tuple(self._parts)

    # --- content ---

    @cached_property
    def topics(self) -> dict[str, TopicInfo]:
        """Topics by name, without the ROS namespace."""
        counts: dict[str, TopicInfo] = {}
        for part in self._parts:
            messages = part.statistics.channel_message_counts
            for channel in part.summary.channels.values():
                name = self.name_of(channel.topic)
                before = counts[name].count if name in counts else 0
                counts[name] = TopicInfo(
                    part.type_of(channel.schema_id), before + messages.get(channel.id, 0)
                )
        return dict(sorted(counts.items()))

    @cached_property
    def publishers(self) -> Counter[tuple[str, str, str]]:
        """Numbers of messages by topic, gid and session of the publisher; without those of unnamed ones."""
        counts: Counter[tuple[str, str, str]] = Counter()
        for part in self._parts:
            for channel in part.summary.channels.values():
                gid, session = _publisher(channel)
                if gid:
                    messages = part.statistics.channel_message_counts.get(channel.id, 0)
                    counts[self.name_of(channel.topic), gid, session] += messages
        return counts

    @cached_property
    def start_ns(self) -> int:
        """Time of arrival of the first message, ns; 0 in a log without messages."""
        return min((part.message_start_time for part in self._filled), default=0)

    @cached_property
    def end_ns(self) -> int:
        """Time of arrival of the last message, ns; 0 in a log without messages."""
        return max((part.message_end_time for part in self._filled), default=0)

    @property
    def _filled(self) -> list[Statistics]:
        return [part.statistics for part in self._parts if part.statistics.message_count]

    @cached_property
    def configuration(self) -> dict[str, dict[str, Any]]:
        """The resolved configuration of every service, by instance; invalid ones are left out."""
        found: dict[str, dict[str, Any]] = {}
        for name, text in self.metadata(CONFIGURATION).items():
            try:
                model = json.loads(text)
                json.dumps(model, ensure_ascii=False).encode()  # half a character cannot be in a report
            except (ValueError, RecursionError):
                model = None
            if not isinstance(model, dict):
                self.unreadable.note(CONFIGURATION, Reason.MALFORMED, f"{name}: is not a JSON object")
                continue
            found[name] = {field: value for field, value in model.items() if _is_read(field, value)}
            for field in model.keys() - found[name].keys():
                self.unreadable.note(CONFIGURATION, Reason.MALFORMED, f"{name}: {field} has another form")
        return found

    def metadata(self, record: str) -> dict[str, str]:
        """Return a metadata record, empty if there is none; later values replace earlier ones."""
        values: dict[str, str] = {}
        for part in self._parts:
            values |= part.metadata(record)
        return values

    @cached_property
    def counts(self) -> dict[str, TopicCount]:
        """The logger's counts by topic, over all files that were closed."""
        totals: dict[str, Counter[str]] = defaultdict(Counter)
        for part in self._parts:
            for topic, text in part.metadata(COUNTS).items():
                try:
                    count = TopicCount.model_validate_json(text)
                except ValueError:
                    self.unreadable.note(COUNTS, Reason.MALFORMED, f"{topic}: is no count")
                    continue
                totals[self.name_of(topic)].update(count.model_dump())
        return {topic: TopicCount(**counter) for topic, counter in totals.items()}

    @cached_property
    def published_before(self) -> dict[str, int]:
        """Numbers of messages that publishers had sent before their first one in the log, by topic.

        Empty unless the logger recorded the numbers of all files.
        """
        firsts: dict[str, dict[str, int]] = defaultdict(dict)
        for part in self._parts:
            if not (record := part.metadata(PUBLISHERS)):
                return {}
            for topic, text in record.items():
                try:
                    publishers = NUMBERS.validate_json(text)
                except ValueError:
                    self.unreadable.note(PUBLISHERS, Reason.MALFORMED, f"{topic}: has no numbers")
                    continue
                known = firsts[self.name_of(topic)]
                for each in publishers:
                    known[each.gid] = min(each.first, known.get(each.gid, each.first))
        return {topic: sum(max(first - 1, 0) for first in known.values()) for topic, known in firsts.items()}

    @cached_property
    def extrinsics(self) -> dict[str, tuple[str, RigidTransform]]:
        """Parent and T_parent_child of every static transform, by child; the last one counts."""
        transforms: dict[str, tuple[str, RigidTransform]] = {}
        for logged in self.messages(TF_STATIC):
            with self.unreadable.left_out(logged):
                for _, parent, child, T_parent_child in read_transforms(logged.decode()):
                    transforms[child] = parent, T_parent_child
        return transforms

    # --- messages ---

    def messages(
        self, *topics: Topic | str, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Logged]:
        """Iterate over messages in the order of arrival.

        Args:
            topics: topics to read; all topics if none is named.
            start_ns: time of arrival from which messages are read.
            end_ns: time of arrival before which messages are read.

        Raises:
            DamagedLogError: the file has damaged bytes in this part.
        """
        names = {topic.name if isinstance(topic, Topic) else topic for topic in topics}
        latched: dict[str, deque[tuple[int, int]]] = {}  # each file repeats the latched messages
        parts = [self._messages_of(part, names, start_ns, end_ns) for part in self._parts]
        for logged in heapq.merge(*parts, key=lambda logged: logged.log_ns):
            if is_latched(logged.topic):
                before = latched.setdefault(logged.topic, deque(maxlen=_MOST_LATCHED))
                identity = logged.sequence, logged.publish_ns
                if identity in before:
                    continue
                before.append(identity)
            yield logged

    def _messages_of(
        self, part: LogFile, names: set[str], start_ns: int | None, end_ns: int | None
    ) -> Iterator[Logged]:
        channels = {
            channel.id: (self.name_of(channel.topic), part.type_of(channel.schema_id), *_publisher(channel))
            for channel in part.summary.channels.values()
            if not names or self.name_of(channel.topic) in names
        }
        if not channels:
            return
        topics = {part.summary.channels[channel].topic for channel in channels}
        found = part.reader.iter_messages(sorted(topics), starting_at=start_ns, ending_before=end_ns)
        for number in count(1):
            with reading(part.path):
                item = next(found, None)
            if item is None:
                return
            if number > part.most_messages:
                raise LogLimitError(part.path, "messages", number, int(part.most_messages))
            _, channel, message = item
            name, type_name, gid, session = channels[channel.id]
            yield Logged(
                name,
                type_name,
                message.log_time,
                message.publish_time,
                message.sequence,
                message.data,
                gid,
                session,
            )

    def odometry(
        self, topic: Topic | str = ESTIMATE, *, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Odometry]:
        """Iterate over a nav_msgs/Odometry topic; ``unreadable`` counts messages that are left out."""
        for logged in self.messages(topic, start_ns=start_ns, end_ns=end_ns):
            with self.unreadable.left_out(logged):
                yield read_odometry(logged.decode())

    def statuses(
        self, topic: Topic | str = STATUS, *, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[EstimatorStatus]:
        """Iterate over the estimator's status; ``unreadable`` counts messages that are left out."""
        for logged in self.messages(topic, start_ns=start_ns, end_ns=end_ns):
            with self.unreadable.left_out(logged):
                yield read_status(logged.decode())

    def name_of(self, channel_topic: str) -> str:
        """Return a topic's name as in the ICD, without leading slash and namespace."""
        return channel_topic.removeprefix("/").removeprefix(self._namespace)

    @cached_property
    def _namespace(self) -> str:
        if self._given_namespace:
            return f"{self._given_namespace}/"
        for service in self.configuration.values():
            bus = service.get("bus")
            if bus and isinstance(namespace := bus.get("namespace"), str) and namespace:
                return f"{namespace}/"
        return ""
