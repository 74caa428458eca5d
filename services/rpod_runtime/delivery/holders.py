"""Which publisher of a topic is used where several publish it (ICD section 2, holders of keys).

The first publisher of a valid message holds the topic until its liveliness token is gone or it is silent.
Then the next one that sends a valid message holds it. Content that is published once (a mount, an info) is
kept for each publisher, because it does not come again when its publisher becomes the holder.

The module knows no bus and no clock; times are those of the messages' arrival, s, which a log has too, so
that a replay finds the same holders (decision 80). Its memory is bounded.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from statistics import median
from typing import Generic, TypeVar

from rpod_schemas.errors import MessageRejectedError, Reason

ContentT = TypeVar("ContentT")

SILENT_S = 2.0
"""Silence after which a publisher no longer holds a topic."""
PERIODS = 3.0
"""Number of its own periods that this silence lasts at least: a slow sensor keeps its topic."""
REMEMBERED_S = 10.0
"""Time for which a publisher that is not used is remembered after its last message."""
MOST_PEERS = 8
"""Largest number of publishers of one topic that are remembered."""
MOST_NAMES = 1000
"""Largest number of names for which content is kept: the frames of ``tf_static``."""


@dataclass(frozen=True, slots=True)
class Peer:
    """A publisher on the bus."""

    gid: bytes
    session: str = ""
    """Zenoh identity of its session; empty if it is unknown."""

    def __str__(self) -> str:
        return f"{self.gid.hex()} (session {self.session or 'unknown'})"


UNKNOWN_PEER = Peer(b"")
"""The publisher of messages that name none, as in tests and logs."""


class SecondPublisherError(MessageRejectedError):
    """A message of a publisher that does not hold the topic."""

    def __init__(self, topic: str, holder: Peer, other: Peer) -> None:
        text = (
            f"two publishers on {topic}: {holder} is used, {other} is not; stop one of them, or `reset` the "
            "estimator with the gid of the one to keep"
        )
        super().__init__(Reason.SECOND_PUBLISHER, text)
        self.holder = holder


@dataclass
class _Topic:
    holder: Peer | None = None
    heard_s: float = 0.0
    gaps_s: deque[float] = field(default_factory=lambda: deque(maxlen=9))
    others: dict[Peer, float] = field(default_factory=dict)
    """Publishers that do not hold the topic, and when each was last heard."""
    left: Peer | None = None
    """The holder whose token has vanished: large messages may arrive behind that, and frames may still wait.
    For ``SILENT_S`` they do not make it the holder again."""
    left_s: float = 0.0

    def holds(self, now_s: float) -> bool:
        """Return whether there is a holder that is not silent."""
        silent_s = max(SILENT_S, PERIODS * median(self.gaps_s or [0.0]))
        return self.holder is not None and now_s - self.heard_s <= silent_s


class Holders:
    """The holder of each topic of a stream."""

    def __init__(self) -> None:
        self._topics: dict[str, _Topic] = {}

    def admit(self, name: str, peer: Peer, now_s: float) -> None:
        """Note a message; raise ``SecondPublisherError`` if another publisher holds the topic."""
        topic = self._topics.setdefault(name, _Topic())
        if topic.left == peer:
            if now_s <= topic.left_s + SILENT_S:
                self.check(name, peer, now_s)
                return
            topic.left = None
        if topic.holder == peer:
            topic.gaps_s.append(max(now_s - topic.heard_s, 0.0))
            topic.heard_s = now_s
            return
        topic.others[peer] = now_s
        for old in [other for other, heard_s in topic.others.items() if now_s - heard_s > REMEMBERED_S]:
            del topic.others[old]
        while len(topic.others) > MOST_PEERS:
            del topic.others[min(topic.others, key=lambda other: topic.others[other])]
        self.check(name, peer, now_s)

    def hold(self, name: str, peer: Peer, now_s: float) -> None:
        """Note a valid message, whose publisher becomes the holder if there is none.

        Raises:
            SecondPublisherError: another publisher holds the topic.
        """
        topic = self._topics.setdefault(name, _Topic())
        if topic.holder == peer:
            topic.heard_s = max(topic.heard_s, now_s)
            return
        self.check(name, peer, now_s)
        if topic.left == peer:
            return
        topic.others.pop(peer, None)
        if topic.holder is not None:
            topic.others[topic.holder] = topic.heard_s
        topic.holder, topic.heard_s = peer, now_s
        topic.gaps_s.clear()

    def check(self, name: str, peer: Peer, now_s: float) -> None:
        """Raise ``SecondPublisherError`` if another publisher holds the topic."""
        topic = self._topics.get(name)
        holder = topic.holder if topic is not None and topic.holds(now_s) else None
        if holder is not None and holder != peer:
            raise SecondPublisherError(name, holder, peer)

    def leave(self, name: str, session: str, *, last: bool = False, now_s: float = 0.0) -> None:
        """Note that the publisher of a session is gone: its liveliness token is.

        Args:
            name: name of the topic.
            session: Zenoh identity of the session.
            last: whether no other publisher of the topic has a token. Then a holder whose session is unknown
                is gone too: messages of rmw_zenoh do not name it.
            now_s: when the token vanished.
        """
        topic = self._topics.get(name)
        if topic is None:
            return
        gone = {session, ""} if last else {session}
        if topic.holder is not None and topic.holder.session in gone:
            topic.left, topic.left_s = topic.holder, now_s
            topic.holder = None
        topic.others = {peer: heard_s for peer, heard_s in topic.others.items() if peer.session != session}

    def release(self, *, keep: str, now_s: float) -> None:
        """Let go of all topics; the publishers of the session ``keep`` hold theirs, if it is not empty."""
        for topic in self._topics.values():
            known = [topic.holder] if topic.holder else []
            kept = [peer for peer in (*known, *topic.others) if keep and peer.session == keep]
            if kept and kept[0] != topic.holder:
                topic.others |= dict.fromkeys(known, now_s)
                topic.others.pop(kept[0], None)
            topic.holder, topic.heard_s = (kept[0] if kept else None), now_s

    def rivals(self, now_s: float) -> Iterator[tuple[str, Peer, Peer]]:
        """Yield topics with more than one publisher: name, holder, and another one heard lately."""
        for name, topic in self._topics.items():
            for other, heard_s in topic.others.items():
                if topic.holder is not None and topic.holds(now_s) and now_s - heard_s <= SILENT_S:
                    yield name, topic.holder, other

    @property
    def peers(self) -> Iterator[Peer]:
        """All publishers that are remembered."""
        for topic in self._topics.values():
            yield from (topic.holder,) if topic.holder else ()
            yield from topic.others


@dataclass
class _Announcement(Generic[ContentT]):
    peer: Peer
    content: ContentT
    gone: bool = False


class Announcements(Generic[ContentT]):
    """Content that is published once, the last one of each publisher, by name."""

    def __init__(self) -> None:
        self._by_name: dict[str, list[_Announcement[ContentT]]] = {}

    def put(self, name: str, peer: Peer, content: ContentT) -> None:
        """Keep the content of a publisher.

        Raises:
            MessageRejectedError: there are too many names.
        """
        if name not in self._by_name and len(self._by_name) >= MOST_NAMES:
            raise MessageRejectedError(
                Reason.TOO_MANY, f"{name} would be the {MOST_NAMES + 1}th name, {MOST_NAMES} at most are kept"
            )
        known = self._by_name.setdefault(name, [])
        for announced in known:
            if announced.peer == peer:
                announced.content, announced.gone = content, False
                return
        known.append(_Announcement(peer, content))
        if len(known) > MOST_PEERS:  # the first one is the holder's
            known.remove(next((each for each in known[1:] if each.gone), known[1]))

    def of(self, name: str, session: str) -> tuple[Peer, ContentT] | None:
        """Return the publisher and content that count for a session's frames; None if there are none.

        A session's own content counts first, then the earliest of a publisher that is not gone, then the
        newest of one that is.
        """
        known = self._by_name.get(name, [])
        own = [each for each in known if session and each.peer.session == session]
        alive = [each for each in known if not each.gone]
        chosen = own[-1:] or alive[:1] or known[-1:]
        return (chosen[0].peer, chosen[0].content) if chosen else None

    def leave(self, name: Callable[[str], bool], session: str) -> None:
        """Note that the publisher of a session is gone, for the names of which ``name`` is true."""
        for known in (known for key, known in self._by_name.items() if name(key)):
            for announced in known:
                announced.gone |= announced.peer.session == session

    def release(self, *, keep: str) -> None:
        """Let the content of the session ``keep`` count first, or the newest if it is empty.

        Content of a publisher that is gone comes after that of all others, as in ``of``.
        """
        for known in self._by_name.values():
            kept = [each for each in known if each.peer.session == keep] if keep else list(known)
            alive = [each for each in kept if not each.gone]
            chosen = (alive or kept)[-1:]
            others = [each for each in known if each not in chosen]
            known[:] = chosen + others if alive else others + chosen

    def rivals(self, name: str) -> list[tuple[Peer, ContentT]]:
        """Return what the publishers of a name that are not gone have announced, the earliest first."""
        return [(each.peer, each.content) for each in self._by_name.get(name, []) if not each.gone]

    @property
    def names(self) -> list[str]:
        """All names."""
        return list(self._by_name)

    @property
    def peers(self) -> Iterator[Peer]:
        """All publishers."""
        return (each.peer for known in self._by_name.values() for each in known)
