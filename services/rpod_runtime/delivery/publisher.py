"""A publisher as the ICD defines it: CDR payload, attachment, and a cache for recovery."""

import secrets
import time
from threading import Lock
from types import TracebackType
from typing import Any, Self

import zenoh
import zenoh.ext

from rpod_schemas.rmw.cdr import encode
from rpod_schemas.rmw.wire import GID_BYTES, Attachment
from rpod_schemas.topics import Namespace, Topic

_HEARTBEAT_S = 0.2


class Publisher:
    """Publishes one topic. Safe to call from several threads.

    Images and point clouds have a queue of their own. On a congested link they wait there and may be dropped,
    and small messages overtake them.
    """

    def __init__(self, session: zenoh.Session, keys: Namespace, topic: Topic) -> None:
        self.topic = topic
        self._gid = secrets.token_bytes(GID_BYTES)
        self._sequence = 0
        self._lock = Lock()
        self._publisher = zenoh.ext.declare_advanced_publisher(
            session,
            keys.key(topic),
            encoding=zenoh.Encoding.APPLICATION_CDR,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.DATA if topic.bulky else zenoh.Priority.DATA_HIGH,
            cache=zenoh.ext.CacheConfig(max_samples=topic.kept),
            sample_miss_detection=zenoh.ext.MissDetectionConfig(
                heartbeat=_HEARTBEAT_S, sporadic_heartbeat=None
            ),
            publisher_detection=True,
        )

    @property
    def published(self) -> int:
        """Number of messages published so far."""
        return self._sequence

    def publish(self, message: Any, *, since_ns: int | None = None) -> None:
        """Encode and publish a message of the topic's type.

        Args:
            message: the message.
            since_ns: time of publication that is stated, if a fault held the message back; by default now.
        """
        self.put(encode(message), since_ns=since_ns)

    def put(self, payload: bytes | bytearray, *, since_ns: int | None = None) -> None:
        """Publish the CDR bytes of a message of the topic's type."""
        with self._lock:
            self._sequence += 1
            attachment = Attachment(self._sequence, since_ns or time.time_ns(), self._gid)
            self._publisher.put(payload, attachment=attachment.pack())

    def lose(self) -> None:
        """Count a message as published without sending it: an injected fault of the bus."""
        with self._lock:
            self._sequence += 1

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._lock:  # Zenoh refuses to undeclare a publisher that another thread uses
            self._publisher.undeclare()  # type: ignore[no-untyped-call]
