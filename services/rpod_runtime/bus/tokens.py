"""Publishers on the bus by their liveliness tokens: who comes, and who is gone.

Anybody may declare a token, also one that names another's session, and take it back. So a publisher counts as
gone only when the last token of its session and topic is. A process of ROS 2 may have several of them too:
its nodes share a session.
"""

from collections.abc import Callable
from threading import Lock

from rpod_schemas.rmw.wire import session_of_token, topic_of_token
from rpod_schemas.topics import Namespace, Topic

MOST_TOKENS = 20_000
"""Largest number of tokens that are remembered. Those beyond it count as the only ones of their publisher."""

LONGEST_TOKEN = 2048
"""Largest number of characters of a token that is read: its namespace, node and topic have 255 at most."""

Tell = Callable[[str, Topic], None]
"""Function that takes the Zenoh identity of a session, and a topic."""


class PublisherTokens:
    """Tells of publishers that come and that are gone. Safe to use from several threads.

    Args:
        keys: the facility's part of the key space; tokens of others are left out.
        came: called with each token that comes.
        gone: called when the last token of a session and topic has vanished.
    """

    def __init__(self, keys: Namespace, *, came: Tell, gone: Tell) -> None:
        self._keys, self._came, self._gone = keys, came, gone
        self._tokens: dict[tuple[str, Topic], set[str]] = {}
        self._count = 0
        self._lock = Lock()

    def take(self, token: str, is_there: bool) -> None:
        """Take a token that comes or vanishes."""
        topic = topic_of_token(token, self._keys) if len(token) <= LONGEST_TOKEN else None
        if topic is None:
            return
        session = session_of_token(token)
        if is_there:
            self._add(session, topic, token)
            self._came(session, topic)
        elif self._is_last(session, topic, token):
            self._gone(session, topic)

    def _add(self, session: str, topic: Topic, token: str) -> None:
        with self._lock:
            if self._count < MOST_TOKENS:
                known = self._tokens.setdefault((session, topic), set())
                self._count += token not in known
                known.add(token)

    def _is_last(self, session: str, topic: Topic, token: str) -> bool:
        """Forget a token; return whether no other one of its publisher is known."""
        with self._lock:
            known = self._tokens.get((session, topic), set())
            self._count -= token in known
            known.discard(token)
            if not known:
                self._tokens.pop((session, topic), None)
            return not known
