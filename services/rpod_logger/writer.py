"""Writes one MCAP file: ROS 2 profile, wire bytes unchanged, readable after a kill (ICD section 5).

It knows neither bus nor threads.
"""

import logging
import re
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Literal

import yaml
from mcap.writer import CompressionType, Writer

from rpod_logger.disk import DiskFile
from rpod_runtime import Received
from rpod_schemas.config.facility.logger import LoggerConfig
from rpod_schemas.logs import (
    ENCODING_METADATA,
    GID_METADATA,
    HASH_METADATA,
    KEY_METADATA,
    MESSAGE_ENCODING,
    OPAQUE,
    OPAQUE_ENCODING,
    PROFILE,
    QOS_METADATA,
    SCHEMA_ENCODING,
    SESSION_METADATA,
)
from rpod_schemas.rmw.cdr import definition
from rpod_schemas.topics import ABSOLUTE_TOPICS, OF_MANY, Namespace, Topic
from rpod_security.log_chain import ChainWriter, Key

log = logging.getLogger(__name__)

Compression = Literal["lz4", "zstd", "none"]

_RECORD_BYTES = 31
"""Size of a message record without its payload."""
_SEQUENCE_MASK = 0xFFFF_FFFF
_OF_MANY = frozenset(topic.name for topic in OF_MANY)
_MOST_CHANNELS = 2000
"""Largest number of publishers that have channels of their own; readers take 10,000 channels."""
_INFINITE = {"sec": 9223372036, "nsec": 854775807}


@dataclass(frozen=True)
class WriterSettings:
    """Options of the files."""

    keys: Namespace
    library: str
    """Name and version of the software, for the file's header."""
    compression: Compression = "lz4"
    chunk_bytes: int = 1 << 20
    reserve_bytes: int = 16 << 20
    """Disk space that is reserved for closing the file."""
    refuses: Callable[[], bool] = lambda: False
    """Function that tells whether the disk counts as full by an injected fault."""
    chained: bool = False
    """Whether a digest chain is written beside each file."""
    key: Key | None = None
    """Key that signs the chain."""


def signing_key(config: LoggerConfig) -> Key | None:
    """Return the key of a logger's certificate; None without a certificate or a chain.

    Raises:
        ChainError: there is a certificate whose key cannot be used.
    """
    if config.bus.credentials is None or not config.chained:
        return None
    from rpod_security.log_signature import SigningKey  # noqa: PLC0415 - of an extra

    return SigningKey.read(config.bus.credentials)


class LogFile:
    """One MCAP file that is being written; made by ``create_log``."""

    def __init__(self, path: Path, settings: WriterSettings, *, before: Path | None = None) -> None:
        self.path = path
        self.messages = 0
        self.bytes = 0
        """Size of all payloads."""
        self._settings = settings
        self._disk = DiskFile(path, reserve_bytes=settings.reserve_bytes, refuses=settings.refuses)
        self._chain = self._begin_chain(before) if settings.chained else None
        self._writer = Writer(
            self._disk,  # type: ignore[arg-type]  # write, tell and flush are what it calls
            chunk_size=settings.chunk_bytes,
            compression=CompressionType[settings.compression.upper()],
        )
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str | bytes], int] = {}
        self._chunk_bytes = 0
        self.pending: Counter[str] = Counter()
        """Number of messages in the open chunk, which is not in the file yet, by topic."""
        self._dirty = True
        try:
            self._writer.start(profile=PROFILE, library=settings.library)
        except BaseException:
            self.abandon()
            raise

    def _begin_chain(self, before: Path | None) -> ChainWriter:
        try:
            chain = ChainWriter(self.path, key=self._settings.key, continues=before)
        except BaseException:  # also where the chain of a log that was deleted is still there
            self._disk.close()
            self.path.unlink(missing_ok=True)
            raise
        self._disk.appended = chain.add
        return chain

    @property
    def size_bytes(self) -> int:
        """Size of the file without the open chunk."""
        return self._disk.tell()

    @property
    def full(self) -> bool:
        """Whether the disk is full: the file can still be closed, but takes no more messages."""
        return self._disk.full

    @property
    def vanished(self) -> bool:
        """Whether the file was deleted or its mount is gone."""
        return self._disk.vanished

    def write(self, received: Received) -> None:
        """Append a message to the open chunk. Raises ``OSError`` if the disk refuses the data."""
        size = len(received.payload) + _RECORD_BYTES
        if self._chunk_bytes + size > self._settings.chunk_bytes:
            self._flush()
        channel = self._channels.get((received.key, received.session or received.attachment.gid))
        if channel is None:
            channel = self._channel_of(received)
        stamp_ns = received.attachment.stamp_ns
        self._writer.add_message(
            channel,
            log_time=max(received.arrival_ns, 0),
            data=received.payload,  # type: ignore[arg-type]  # written as it is, never copied
            publish_time=stamp_ns if stamp_ns > 0 else max(received.arrival_ns, 0),
            sequence=received.attachment.sequence & _SEQUENCE_MASK,
        )
        self.messages += 1
        self.bytes += len(received.payload)
        self._chunk_bytes += size
        self.pending[received.topic.name] += 1
        self._dirty = True

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Append a metadata record."""
        self._writer.add_metadata(name, values)
        self._dirty = True

    def sync(self) -> None:
        """Write everything so far, including the open chunk, to the disk."""
        if self._dirty:
            self._flush()
            self._disk.sync()
            self._seal()
            self._dirty = False

    def close(self) -> None:
        """Finish the file: index, statistics, footer."""
        self._flush()
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._disk.sync()
        self._seal(closed=True)
        self._end_chain()
        self._disk.close()

    def _seal(self, *, closed: bool = False) -> None:
        """Add to the chain; where that fails, the log goes on without it."""
        if self._chain is None:
            return
        try:
            self._chain.seal(closed=closed)
        except OSError as error:
            log.error("%s: its digest chain ends here: %s", self.path.name, error.strerror)
            self._end_chain()

    def _end_chain(self) -> None:
        if self._chain is not None:
            self._chain.close()
            self._disk.appended = lambda _: None
            self._chain = None

    def abandon(self) -> None:
        """Leave the file as it is after the disk has failed; it ends after the last complete record."""
        self._end_chain()
        with suppress(OSError):
            self._disk.close()

    def _flush(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._chunk_bytes = 0
        self.pending.clear()

    def _channel_of(self, received: Received) -> int:
        """Return the channel of a publisher: its own, or that of all publishers of a topic that many publish.

        Beyond ``_MOST_CHANNELS`` further publishers share one that names none.
        """
        shared = received.topic.name in _OF_MANY or not received.topic.type
        publisher: str | bytes = "" if shared else received.session or received.attachment.gid
        if len(self._channels) >= _MOST_CHANNELS:
            publisher = ""
        place = received.key, publisher
        if place not in self._channels:
            self._channels[place] = self._register(received, named=bool(publisher))
        return self._channels[place]

    def _register(self, received: Received, *, named: bool) -> int:
        topic = received.topic
        ros = {QOS_METADATA: qos_profile(topic), HASH_METADATA: received.key.rsplit("/", 1)[-1]}
        if named:
            ros |= {GID_METADATA: received.attachment.gid.hex(), SESSION_METADATA: received.session}
        opaque = {KEY_METADATA: received.key, ENCODING_METADATA: received.encoding}
        return self._writer.register_channel(
            channel_topic(self._settings.keys, topic.name),
            MESSAGE_ENCODING if topic.type else OPAQUE_ENCODING,
            self._schema(topic.type),
            ros if topic.type else opaque,
        )

    def _schema(self, type_name: str) -> int:
        if type_name not in self._schemas:
            text = definition(type_name).encode() if type_name else b""
            self._schemas[type_name] = self._writer.register_schema(
                type_name or OPAQUE, SCHEMA_ENCODING if type_name else "", text
            )
        return self._schemas[type_name]


def create_log(directory: Path, stem: str, settings: WriterSettings) -> LogFile:
    """Create ``<stem>.mcap``, or ``<stem>_0002.mcap`` and so on if there are earlier ones.

    It never overwrites a file. The name sorts after those of all earlier files, whatever the clock shows.

    Raises:
        OSError: the directory or the file cannot be created.
    """
    directory.mkdir(parents=True, exist_ok=True)
    for number in count(_last_number(directory, stem) + 1):
        before = _path(directory, stem, number - 1) if number > 1 else None
        with suppress(FileExistsError):
            return LogFile(_path(directory, stem, number), settings, before=before)
    raise AssertionError("unreachable")


def _path(directory: Path, stem: str, number: int) -> Path:
    return directory / (f"{stem}.mcap" if number == 1 else f"{stem}_{number:04d}.mcap")


def _last_number(directory: Path, stem: str) -> int:
    """Return the highest number in use, 1 for the bare name, 0 for none."""
    form = re.compile(rf"{re.escape(stem)}(?:_(\d{{4,}}))?\.mcap")
    names = (form.fullmatch(path.name) for path in directory.iterdir())
    return max((int(name[1] or 1) for name in names if name), default=0)


def channel_topic(keys: Namespace, name: str) -> str:
    """Return a topic's name in the log: absolute, with the ROS namespace, as in rosbag2."""
    absolute = any(name == topic.name for topic in ABSOLUTE_TOPICS)
    return f"/{keys.prefix}/{name}" if keys.prefix and not absolute else f"/{name}"


def qos_profile(topic: Topic) -> str:
    """Return the quality of service that the ICD gives a topic, in the YAML of rosbag2 since Jazzy."""
    offered = topic.offered
    profile = {
        "history": "keep_last",
        "depth": offered.depth,
        "reliability": "reliable",
        "durability": "transient_local" if offered.transient_local else "volatile",
        "deadline": dict(_INFINITE),
        "lifespan": {"sec": offered.lifespan_s, "nsec": 0} if offered.lifespan_s else dict(_INFINITE),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(_INFINITE),
        "avoid_ros_namespace_conventions": False,
    }
    return yaml.safe_dump([profile], sort_keys=False)
