"""Holders of topics in a log (ICD section 2): of several publishers of a topic one is used, as in a live run.

A live run learns from a liveliness token that a publisher is gone. No log contains such tokens. In a replay a
session ends with the last message of its streams, unless the log ends before the session would count as
silent. So a successor may be used a little earlier than in the live run.
"""

import json
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from functools import partial

from rpod_analysis.log import Log, Logged
from rpod_analysis.log.sensors import as_received
from rpod_runtime import Received
from rpod_runtime.assembler import Assembled
from rpod_runtime.delivery.holders import SILENT_S, Holders, SecondPublisherError
from rpod_runtime.delivery.kept import KeptMessages
from rpod_schemas.logs import PUBLISHERS
from rpod_schemas.rmw.cdr import NANOSECONDS


def of_holders(log: Log, *topics: str, unused: Counter[str]) -> Iterator[tuple[Logged, Callable[[], None]]]:
    """Yield the messages whose publishers may be used, each with a function that makes the publisher hold it.

    Args:
        log: the log.
        topics: names of topics whose readings an estimator takes one by one.
        unused: number of messages of other publishers, by topic, to which is added.
    """
    holders = Holders()
    for logged in log.messages(*topics):
        received = as_received(logged)
        name, peer, now_s = logged.topic, received.peer, received.arrival_s
        try:
            holders.check(name, peer, now_s)
        except SecondPublisherError:
            unused[name] += 1
            continue
        yield logged, partial(holders.hold, name, peer, now_s)


class LoggedHolders:
    """The holders of a log's streams at the time of each message.

    Args:
        log: the log.
        streams: names of the streams' topics.
    """

    def __init__(self, log: Log, streams: Collection[str]) -> None:
        self._log, self._streams = log, frozenset(streams)
        self._holders, self._now_s = Holders(), 0.0
        self.kept = KeptMessages(self._holders)
        """Messages that last, of publishers that did not hold their topic yet."""
        self._left: Counter[str] = Counter()
        for (topic, _, session), messages in log.publishers.items():
            if topic in self._streams and session:
                self._left[session] += messages
        self.unused: Counter[str] = Counter()
        """Number of messages of publishers that did not hold their topic, by topic."""

    def admit(self, received: Received, *, lasts: bool = False) -> bool:
        """Note a message of a stream; return whether it may be used.

        Args:
            received: the message.
            lasts: whether it is valid until another comes, so that it may be used later.
        """
        self._now_s = received.arrival_s
        try:
            if lasts:
                self.kept.admit(received)
            else:
                self._holders.admit(received.topic.name, received.peer, received.arrival_s)
        except SecondPublisherError:
            self.unused[received.topic.name] += 1
            return False
        return True

    def allows(self, frame: Assembled[Received]) -> bool:
        """Return whether no other publisher holds a topic of a frame."""
        for part in frame.parts.values():
            try:
                self._holders.check(part.topic.name, part.peer, part.arrival_s)
            except SecondPublisherError:
                self.unused[part.topic.name] += 1
                return False
        return True

    def hold(self, frame: Assembled[Received], leading: str) -> None:
        """Note a valid frame. Its publishers hold their topics from now on.

        A topic that another publisher holds stays its own: a live run may have decided otherwise.
        """
        session = frame.parts[leading].session
        now_s = max(part.arrival_s for part in frame.parts.values())
        for part in frame.parts.values():
            heard_s = now_s if part.session == session else part.arrival_s
            if not self.kept.may_hold(part):
                continue
            with suppress(SecondPublisherError):
                self._holders.hold(part.topic.name, part.peer, heard_s)

    def ended(self, received: Received) -> str:
        """Return the session that ends with a message, and release its topics; empty if none ends."""
        session = received.session
        if not session or received.topic.name not in self._streams:
            return ""
        self._left[session] -= 1
        stays = self._log.end_ns - received.arrival_ns < SILENT_S * NANOSECONDS
        if self._left[session] != 0 or stays:
            return ""
        for topic in self._streams:
            self._holders.leave(topic, session)
            self.kept.leave(topic, session)
        return session

    def release(self, keep_gid: str | None) -> str:
        """Give up all topics, as a reset does; return the session whose publishers are kept, if any."""
        named = (session for _, gid, session in self._log.publishers if gid == keep_gid)
        keep = next(named, "") if keep_gid else ""
        self._holders.release(keep=keep, now_s=self._now_s)
        return keep

    @property
    def undivided(self) -> dict[str, int]:
        """Number of publishers of each stream whose messages the log does not distinguish: all are used."""
        named = {topic for topic, _, _ in self._log.publishers}
        found = {}
        for channel, text in self._log.metadata(PUBLISHERS).items():
            topic = self._log.name_of(channel)
            if topic in self._streams - named:
                with suppress(ValueError, TypeError, KeyError, RecursionError):
                    found[topic] = len({each["gid"] for each in json.loads(text)})
        return {topic: publishers for topic, publishers in sorted(found.items()) if publishers > 1}
