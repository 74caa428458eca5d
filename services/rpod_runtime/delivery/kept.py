"""Messages of publishers that do not hold their topic yet, and that may be sent only once.

A driver may send its camera_info only once, when it starts. If another driver has just ended, that one still
holds the topic, and the message is refused. It is kept here until its publisher may be used. Otherwise the
frames of the new driver would be used with the camera_info of the old one for ever.

As in ``holders``, times are those of the messages' arrival, s, and memory is bounded.
"""

from dataclasses import replace

from rpod_runtime.delivery.holders import MOST_PEERS, Holders, Peer, SecondPublisherError
from rpod_runtime.delivery.inbox import Received


class KeptMessages:
    """The last refused message of each publisher of a topic, until it counts or another one does.

    Args:
        holders: the holders of the topics.
    """

    def __init__(self, holders: Holders) -> None:
        self._holders = holders
        self._kept: dict[str, dict[Peer, tuple[Peer, Received]]] = {}
        """By topic and publisher, the newest last: the holder for which it was refused, and the message."""
        self._unheld: dict[str, Received] = {}
        """By topic, the message that counts although its publisher does not hold the topic."""

    def admit(self, received: Received) -> None:
        """Note a message as ``Holders.admit`` does; keep it if that refuses it.

        Raises:
            SecondPublisherError: another publisher holds the topic.
        """
        name, peer = received.topic.name, received.peer
        kept = self._kept.setdefault(name, {})
        kept.pop(peer, None)
        try:
            self._holders.admit(name, peer, received.arrival_s)
        except SecondPublisherError as error:
            kept[peer] = error.holder, received
            if len(kept) > MOST_PEERS:
                del kept[next(iter(kept))]
            raise
        # Messages that waited for an earlier holder lose: this publisher is that holder's successor.
        self._kept[name] = {other: each for other, each in kept.items() if each[0] == peer}
        self._unheld.pop(name, None)

    def due(self, name: str, leading: Received) -> Received | None:
        """Return the newest message of a topic whose publisher may be used from a frame on, if there is one.

        Args:
            name: name of the topic.
            leading: leading part of the frame. A message of another known session is not of its publisher.
        """
        for peer, (_, received) in reversed(self._kept.get(name, {}).items()):
            if peer.session and leading.session and peer.session != leading.session:
                continue
            try:
                self._holders.check(name, peer, leading.arrival_s)
            except SecondPublisherError:
                return None
            del self._kept[name]
            found = replace(received, arrival_s=leading.arrival_s)
            if not peer.session:
                self._unheld[name] = found
            return found
        return None

    def may_hold(self, part: Received) -> bool:
        """Return whether the publisher of a part may become the holder of its topic.

        Where a message that was kept names no session, nothing tells whether its publisher is that of the
        frames. Then the next message of the topic counts, whoever sends it.
        """
        return self._unheld.get(part.topic.name) is not part

    def leave(self, name: str, session: str) -> None:
        """Note that the publisher of a session is gone."""
        kept = self._kept.get(name, {})
        if session:
            self._kept[name] = {peer: each for peer, each in kept.items() if peer.session != session}
