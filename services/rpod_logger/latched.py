"""The last latched message of each publisher, with which the next file begins. Its memory is bounded."""

import logging
from collections import OrderedDict
from collections.abc import Iterator

from rpod_runtime import Received

log = logging.getLogger(__name__)

MOST_MESSAGES = 1000
MOST_BYTES = 64 << 20
"""Largest number of messages, and largest size of all of them."""

Publisher = tuple[str, bytes, str]
"""Key, gid, and Zenoh identity of the session."""


class LatchedMessages:
    """Latched messages, the newest of each publisher; those that were not sent for longest are forgotten."""

    def __init__(self) -> None:
        self._messages: OrderedDict[Publisher, Received] = OrderedDict()
        self._bytes = 0
        self.forgotten = 0
        """Number of messages that were forgotten, because there were too many."""

    def keep(self, received: Received) -> None:
        """Keep a message in place of the one before of its publisher."""
        publisher = received.key, received.attachment.gid, received.session
        before = self._messages.pop(publisher, None)
        self._bytes += len(received.payload) - (len(before.payload) if before is not None else 0)
        self._messages[publisher] = received
        while len(self._messages) > MOST_MESSAGES or self._bytes > MOST_BYTES:
            self._forget()

    def _forget(self) -> None:
        _, oldest = self._messages.popitem(last=False)
        self._bytes -= len(oldest.payload)
        if not self.forgotten:
            log.warning(
                "more than %d latched messages, or %d MiB of them: the next file begins without the rest",
                MOST_MESSAGES,
                MOST_BYTES >> 20,
            )
        self.forgotten += 1

    def __iter__(self) -> Iterator[Received]:
        return iter(self._messages.values())
