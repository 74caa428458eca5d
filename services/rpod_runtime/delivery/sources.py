"""Which session sends under a gid: a gid belongs to one publisher, and so to one session.

Anybody on a plain bus can copy a gid. Messages of a second session under it would count in the sequence of
the first one: with numbers slightly ahead they make the messages that follow duplicates. So they are refused
until the first session has been silent for a while, as a restarted publisher of a constant gid is heard then.

The module knows no bus and no clock; times are those of the messages' arrival, s. Its memory is bounded.
"""

from collections import OrderedDict
from dataclasses import dataclass

from rpod_runtime.delivery.holders import SILENT_S, Peer
from rpod_schemas.errors import MessageRejectedError, Reason

MOST_GIDS = 4096
"""Largest number of gids that are remembered; of more the one that was silent longest is forgotten."""


class SecondSourceError(MessageRejectedError):
    """A message under the gid of a publisher of another session."""

    def __init__(self, known: Peer, session: str) -> None:
        super().__init__(
            Reason.SECOND_SOURCE,
            f"gid {known} is used by a second session, {session or 'unknown'}, whose messages are refused; "
            "stop that one, or give each publisher a gid of its own",
        )


@dataclass(slots=True)
class _Source:
    session: str
    heard_s: float


class Sources:
    """The session of each gid."""

    def __init__(self) -> None:
        self._sources: OrderedDict[bytes, _Source] = OrderedDict()

    def admit(self, gid: bytes, session: str, now_s: float) -> bool:
        """Note a message; return whether its session is the first one of the gid, or replaces another one.

        Args:
            gid: gid of the publisher.
            session: Zenoh identity of its session; empty where the message names none.
            now_s: time of the arrival.

        Raises:
            SecondSourceError: another session uses the gid, and was heard a short time ago.
        """
        source = self._sources.get(gid)
        if source is not None and source.session == session:
            source.heard_s = now_s
            self._sources.move_to_end(gid)
            return False
        if source is not None and now_s - source.heard_s <= SILENT_S:
            raise SecondSourceError(Peer(gid, source.session), session)
        self._sources[gid] = _Source(session, now_s)
        self._sources.move_to_end(gid)
        if len(self._sources) > MOST_GIDS:
            self._sources.popitem(last=False)
        return True
