"""The log that a replay writes: unchanged truth and old estimates, and the new estimates beside them."""

import json
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from mcap.writer import CompressionType, Writer

from rpod_analysis.log import Log, Logged
from rpod_logger.writer import qos_profile
from rpod_pose.navigation.state import Output
from rpod_schemas.caches.whole_file import whole_file
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.config.migration import logged
from rpod_schemas.logs import (
    CONFIGURATION,
    HASH_METADATA,
    MESSAGE_ENCODING,
    PROFILE,
    QOS_METADATA,
    REPLAY,
    SCHEMA_ENCODING,
    SOFTWARE,
)
from rpod_schemas.messages import (
    write_integrity,
    write_joints,
    write_odometry,
    write_pose_stamped,
    write_status,
)
from rpod_schemas.rmw.cdr import definition, encode, type_hash
from rpod_schemas.topics import (
    ESTIMATE,
    ESTIMATE_FRAME,
    ESTIMATE_JOINTS,
    ESTIMATE_POSE,
    INTEGRITY,
    STATUS,
    TOPICS,
    Topic,
)
from rpod_schemas.types import Integrity
from rpod_target import Target

_LATCHED = {topic.name for topic in TOPICS if topic.latched}


class EstimateLog:
    """An open log, whose content does not depend on the time of writing. A failure leaves no file."""

    def __init__(self, path: Path, source: Log, config: EstimatorConfig, target: Target) -> None:
        self.last_ns = 0
        """Time of arrival of the last copied message, ns."""
        self._path, self._source, self._config, self._frames = path, source, config, target.frames
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._sequences: Counter[str] = Counter()

    def __enter__(self) -> Self:
        self._whole = whole_file(self._path, durable=True)  # an older log stays until this one is complete
        self._stream = self._whole.__enter__()
        self._writer = Writer(self._stream, compression=CompressionType.LZ4)
        self._writer.start(profile=PROFILE, library="rpod replay")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._describe()
                self._writer.finish()  # type: ignore[no-untyped-call]
        except BaseException:
            self._whole.__exit__(*sys.exc_info())
            raise
        self._whole.__exit__(kind, error, trace)

    def copy(self, logged: Logged) -> None:
        """Add an unchanged message."""
        self.last_ns = logged.log_ns
        topic = Topic(logged.topic, logged.type, logged.topic in _LATCHED)
        self._put(
            topic,
            logged.payload,
            log_ns=logged.log_ns,
            publish_ns=logged.publish_ns,
            sequence=logged.sequence,
        )

    def add(self, checked: Iterable[tuple[Output, Integrity]], *, arrival_ns: int) -> None:
        """Add the estimator's results for a frame and their integrity, with the frame's time of arrival."""
        for output, integrity in checked:
            if output.odometry is not None:
                self._add(ESTIMATE, write_odometry(output.odometry), arrival_ns)
                self._add(ESTIMATE_POSE, write_pose_stamped(output.odometry), arrival_ns)
                for name, pose in self._frames.items():
                    message = write_pose_stamped(output.odometry, T_child_frame=pose)
                    self._add(ESTIMATE_FRAME.at(name), message, arrival_ns)
            if output.joints is not None:
                self._add(ESTIMATE_JOINTS, write_joints(output.joints), arrival_ns)
            self._add(INTEGRITY, write_integrity(integrity), arrival_ns)
            self._add(STATUS, write_status(output.status), arrival_ns)

    def _add(self, topic: Topic, message: Any, arrival_ns: int) -> None:
        self._sequences[topic.name] += 1
        self._put(
            topic.under(REPLAY),
            bytes(encode(message)),
            log_ns=arrival_ns,
            publish_ns=arrival_ns,
            sequence=self._sequences[topic.name],
        )

    def _put(self, topic: Topic, payload: bytes, *, log_ns: int, publish_ns: int, sequence: int) -> None:
        self._writer.add_message(
            self._channel(topic), log_time=log_ns, publish_time=publish_ns, sequence=sequence, data=payload
        )

    def _channel(self, topic: Topic) -> int:
        if topic.name not in self._channels:
            if topic.type not in self._schemas:
                text = definition(topic.type).encode()
                self._schemas[topic.type] = self._writer.register_schema(topic.type, SCHEMA_ENCODING, text)
            metadata = {QOS_METADATA: qos_profile(topic), HASH_METADATA: type_hash(topic.type)}
            self._channels[topic.name] = self._writer.register_channel(
                f"/{topic.name}", MESSAGE_ENCODING, self._schemas[topic.type], metadata
            )
        return self._channels[topic.name]

    def _describe(self) -> None:
        """Add the source's metadata, without its namespace, and the configuration of the new estimates."""
        services = {
            name: model | ({"bus": model["bus"] | {"namespace": ""}} if "bus" in model else {})
            for name, model in self._source.configuration.items()
        }
        services[REPLAY] = logged(self._config) | {"instance": REPLAY, "prefix": REPLAY}
        self._writer.add_metadata(SOFTWARE, self._source.metadata(SOFTWARE))
        self._writer.add_metadata(
            CONFIGURATION, {name: json.dumps(model) for name, model in services.items()}
        )
