"""Delivers samples of the bus to subscribers; counts unusable, duplicate, missed and recovered ones."""

import logging
import time
from collections.abc import Callable
from dataclasses import replace

import zenoh
import zenoh.ext

from rpod_runtime.delivery.accounting import (
    MOST_KEYS,
    MOST_PUBLICATIONS,
    JumpError,
    Publication,
    SequenceAccount,
    TooManyKeysError,
)
from rpod_runtime.delivery.flow import Flow
from rpod_runtime.delivery.inbox import Received
from rpod_runtime.health import HealthBook
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.rmw.wire import UNNUMBERED, Attachment, unpack_attachment
from rpod_schemas.topics import Namespace, Topic

log = logging.getLogger(__name__)

_REPLAYED = zenoh.CongestionControl.BLOCK
"""Congestion control of replies from a cache. Publishers of this package use DROP for live messages."""

_OTHERS = "others"
"""Topic under which messages of too many keys are counted."""

Sink = Callable[[Received], object]


class Delivery:
    """Delivers messages to subscribers. It runs in the threads of the bus, never raises and never waits."""

    def __init__(self, keys: Namespace, health: HealthBook, account: SequenceAccount) -> None:
        self._keys, self._health, self._account = keys, health, account
        self._topics: dict[str, Topic] = {}
        """Topic of each key that matched a pattern."""
        self._publications: dict[str, Publication] = {}
        self._sessions: dict[bytes, str] = {}
        """Zenoh identity of the session of each publisher, by gid."""
        self._forgets = False
        self.flow = Flow()
        """Rate and age of messages of bulky topics; messages from a cache do not count."""

    def take(self, topic: Topic, sample: zenoh.Sample, sink: Sink) -> None:
        """Deliver a message of a topic or of a pattern, unless it is a duplicate or unusable."""
        key = str(sample.key_expr)
        if "*" in topic.name:
            topic = self._topics.get(key) or self._name(topic, key)
        try:
            attachment = _attachment(sample)
            self._account_for(key, sample, attachment)
            received = _received(topic, key, sample, attachment, self._sessions.get(attachment.gid, ""))
            if topic.bulky and sample.congestion_control != _REPLAYED:
                age_s = (received.arrival_ns - attachment.stamp_ns) * 1e-9
                self.flow.add(topic.name, len(received.payload), age_s)
            sink(received)
        except JumpError as error:
            self._health.warn(f"sequence_jump/{topic.name}", str(error))
            self.reject(topic.name, error)
        except TooManyKeysError as error:
            self.reject(_OTHERS, error)
        except MessageRejectedError as error:
            self.reject(topic.name, error)
        except Exception:  # otherwise the bus's thread prints it and it is not counted
            self._health.count(f"failed/{topic.name}")
            log.exception("a message on %s could not be handled", topic.name)

    def take_any(self, sample: zenoh.Sample, sink: Sink) -> None:
        """Deliver a message of any key; a key that is no known ROS topic needs no attachment."""
        key = str(sample.key_expr)
        topic = self._keys.topic_at(key)
        if topic.type or _is_numbered(sample):
            self.take(topic, sample, sink)
        else:
            sink(_received(topic, key, sample, UNNUMBERED))

    def miss(self, miss: zenoh.ext.Miss) -> None:
        """Count messages that the bus could not recover, if their publisher is known from earlier ones."""
        publication = self._publications.get(str(miss.source))
        if publication:
            self._account.miss(publication, miss.nb)

    def reject(self, topic: str, error: MessageRejectedError) -> None:
        """Count a rejected message; log the first of its kind, and then one a minute."""
        if self._health.reject(topic, error):
            log.warning(
                "rejected a message on %s: %s; further ones are counted, and logged once a minute",
                topic,
                error,
            )

    def _name(self, pattern: Topic, key: str) -> Topic:
        """Return the topic of a key that matched a pattern, and remember it."""
        topic = replace(pattern, name=self._keys.topic_of(key))
        if len(self._topics) < MOST_KEYS:
            self._topics[key] = topic
        return topic

    def _account_for(self, key: str, sample: zenoh.Sample, attachment: Attachment) -> None:
        if attachment.gid not in self._sessions and sample.source_info:
            source = sample.source_info.source_id
            if len(self._sessions) >= MOST_PUBLICATIONS:
                del self._sessions[next(iter(self._sessions))]
                del self._publications[next(iter(self._publications))]
            self._sessions[attachment.gid] = str(source.zid)
            self._publications[str(source)] = key, attachment.gid
        fetched = sample.congestion_control == _REPLAYED
        self._account.take(key, attachment, fetched=fetched)
        if self._account.forgotten:
            self._log_forgotten()

    def _log_forgotten(self) -> None:
        if not self._forgets:
            self._forgets = True
            log.warning(
                "there were more than %d publishers; the longest silent are forgotten: the next message "
                "of each counts as its first",
                MOST_PUBLICATIONS,
            )
        self._health.put("publishers/forgotten", self._account.forgotten)


def _attachment(sample: zenoh.Sample) -> Attachment:
    attachment = sample.attachment
    return unpack_attachment(attachment.to_bytes() if attachment else None)


def _is_numbered(sample: zenoh.Sample) -> bool:
    try:
        _attachment(sample)
    except MessageRejectedError:
        return False
    return True


def _received(
    topic: Topic, key: str, sample: zenoh.Sample, attachment: Attachment, session: str = ""
) -> Received:
    payload = memoryview(sample.payload.to_bytes())
    encoding = "" if topic.type else str(sample.encoding)
    return Received(topic, key, payload, attachment, time.time_ns(), encoding=encoding, session=session)
