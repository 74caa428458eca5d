"""Delivers samples of the bus to subscribers; counts unusable, duplicate, missed and recovered ones."""

import logging
import time
from collections import OrderedDict
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
from rpod_runtime.delivery.sources import SecondSourceError, Sources
from rpod_runtime.health import HealthBook
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.rmw.wire import UNNUMBERED, Attachment, unpack_attachment
from rpod_schemas.texts import shown
from rpod_schemas.topics import TOPICS, Namespace, Topic

log = logging.getLogger(__name__)

_REPLAYED = zenoh.CongestionControl.BLOCK
"""Congestion control of replies from a cache. Publishers of this package use DROP for live messages."""

_OTHERS = "others"
"""Topic under which messages of too many keys, and of keys that are too long, are counted."""
LONGEST_KEY = 512
"""Largest number of characters of a key: ROS 2 allows topics of 247, type and hash follow. Zenoh's keys may
have 65,535, and each heartbeat repeats the names of all topics with their counts."""
MOST_BYTES = 8 << 20
"""Largest message of the ICD that is no image and no point cloud, bytes: a scan pattern has 1 MiB at most.
The last messages of latched topics are kept for each publisher."""
_SMALL = frozenset(topic.type for topic in TOPICS if not topic.bulky)

Sink = Callable[[Received], object]


class LongKeyError(MessageRejectedError):
    """A message of a key that is longer than any topic's."""

    def __init__(self, key: str) -> None:
        super().__init__(
            Reason.TOO_LONG,
            f"a key of {len(key)} characters, at most {LONGEST_KEY} are received: {key[:60]}...; stop its "
            "publisher, or give it a shorter topic",
        )


class LongMessageError(MessageRejectedError):
    """A message that is longer than any of its type."""

    def __init__(self, type_name: str, size: int) -> None:
        super().__init__(
            Reason.TOO_LONG,
            f"a message of {size} bytes, at most {MOST_BYTES} are received of {type_name}; correct its "
            "publisher",
        )


class Delivery:
    """Delivers messages to subscribers. It runs in the threads of the bus, never raises and never waits."""

    def __init__(self, keys: Namespace, health: HealthBook, account: SequenceAccount) -> None:
        self._keys, self._health, self._account = keys, health, account
        self._topics: dict[str, Topic] = {}
        """Topic of each key that matched a pattern."""
        self._publications: OrderedDict[str, Publication] = OrderedDict()
        """Publications by the publisher that Zenoh names."""
        self._sources = Sources()
        self._unnumbered: set[str] = set()
        """Keys of messages without a number."""
        self._forgets = False
        self.flow = Flow()
        """Rate and age of messages of bulky topics; messages from a cache do not count."""

    def take(self, topic: Topic, sample: zenoh.Sample, sink: Sink) -> None:
        """Deliver a message of a topic or of a pattern, unless it is a duplicate or unusable."""
        key = str(sample.key_expr)
        try:
            if "*" in topic.name:
                topic = self._topics.get(key) or self._name(topic, key)
            if topic.type in _SMALL and len(sample.payload) > MOST_BYTES:
                raise LongMessageError(topic.type, len(sample.payload))
            attachment = _attachment(sample)
            received = _received(topic, key, sample, attachment, _session(sample))
            self._account_for(received, sample)
            if topic.bulky and sample.congestion_control != _REPLAYED:
                age_s = (received.arrival_ns - attachment.stamp_ns) * 1e-9
                self.flow.add(topic.name, len(received.payload), age_s)
            sink(received)
        except JumpError as error:
            self._health.warn(f"sequence_jump/{topic.name}", str(error))
            self.reject(topic.name, error)
        except SecondSourceError as error:
            self._health.warn(f"second_source/{topic.name}", error.text)
            self.reject(topic.name, error)
        except (TooManyKeysError, LongKeyError) as error:
            self.reject(_OTHERS, error)
        except MessageRejectedError as error:
            self.reject(topic.name, error)
        except Exception:  # otherwise the bus's thread prints it and it is not counted
            self._health.count(f"failed/{topic.name}")
            log.exception("a message on %s could not be handled", shown(topic.name))

    def take_any(self, sample: zenoh.Sample, sink: Sink) -> None:
        """Deliver a message of any key; a key that is no known ROS topic needs no attachment."""
        key = str(sample.key_expr)
        try:
            _check_length(key)
            topic = self._keys.topic_at(key)
            if topic.type or _is_numbered(sample):
                self.take(topic, sample, sink)
                return
            if key not in self._unnumbered and len(self._unnumbered) >= MOST_KEYS:
                raise TooManyKeysError(key)
        except MessageRejectedError as error:
            self.reject(_OTHERS, error)
            return
        self._unnumbered.add(key)
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
                shown(topic),
                error,
            )

    def _name(self, pattern: Topic, key: str) -> Topic:
        """Return the topic of a key that matched a pattern, and remember it. Raises ``LongKeyError``."""
        _check_length(key)
        topic = replace(pattern, name=self._keys.topic_of(key))
        if len(self._topics) < MOST_KEYS:
            self._topics[key] = topic
        return topic

    def _account_for(self, received: Received, sample: zenoh.Sample) -> None:
        """Count a message in the sequence of its publisher. Raises ``MessageRejectedError``."""
        gid, source = received.attachment.gid, sample.source_info
        is_new = self._sources.admit(gid, received.session, received.arrival_s)
        if is_new:
            self._account.restart(received.key, gid)
        if is_new and source:
            self._publications[str(source.source_id)] = received.key, gid
            if len(self._publications) > MOST_PUBLICATIONS:
                self._publications.popitem(last=False)
        fetched = sample.congestion_control == _REPLAYED
        self._account.take(received.key, received.attachment, fetched=fetched)
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


def _check_length(key: str) -> None:
    if len(key) > LONGEST_KEY:
        raise LongKeyError(key)


def _session(sample: zenoh.Sample) -> str:
    """Return the Zenoh identity of a message's session; empty if it names none."""
    return str(sample.source_info.source_id.zid) if sample.source_info else ""


def _received(
    topic: Topic, key: str, sample: zenoh.Sample, attachment: Attachment, session: str = ""
) -> Received:
    payload = memoryview(sample.payload.to_bytes())
    encoding = "" if topic.type else str(sample.encoding)
    return Received(topic, key, payload, attachment, time.time_ns(), encoding=encoding, session=session)
