"""The queue between the bus and the disk, bounded in bytes; messages that do not fit are counted.

The bus's threads put messages into it and never wait. The writer's thread takes them out. Commands are in the
same queue, so that a file ends exactly between two messages, with the counts of that moment.
"""

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from threading import Condition

from rpod_runtime import Received

_OVERHEAD_BYTES = 512
"""Memory of a queued message in addition to its payload."""
_BATCH_BYTES = 4 << 20
"""Size of the queue at which the writer is woken, and the most that it takes at once. For less it wakes by
its own timeout, so that not each message wakes it."""


Action = Callable[[Counter[str]], None]
"""Function of a command; its argument is the number of messages by topic, received before the command."""


@dataclass(frozen=True)
class Command:
    """Work for the writer's thread, done after everything that was queued before it."""

    action: Action
    received: Counter[str]


class Backlog:
    """Messages and commands in order of arrival."""

    def __init__(self, capacity_bytes: int) -> None:
        self.capacity_bytes = capacity_bytes
        self.bytes = 0
        """Size of the messages in the queue and of those that the writer has taken and not finished."""
        self.high_water_bytes = 0
        self._taken_bytes = 0
        self._received: Counter[str] = Counter()
        self._items: deque[Received | Command] = deque()
        self._changed = Condition()
        self._closed = False

    def put(self, received: Received) -> bool:
        """Enqueue a message; return False if there was no room. After ``close`` messages are ignored."""
        size = len(received.payload) + _OVERHEAD_BYTES
        with self._changed:
            if self._closed:
                return True
            self._received[received.topic.name] += 1
            if self.bytes + size > self.capacity_bytes:
                return False
            self.bytes += size
            self.high_water_bytes = max(self.high_water_bytes, self.bytes)
            self._items.append(received)
            if self.bytes > _BATCH_BYTES:
                self._changed.notify()
        return True

    def command(self, action: Action) -> bool:
        """Enqueue a command, for which there is always room; return False after ``close``."""
        with self._changed:
            if self._closed:
                return False
            self._items.append(Command(action, self._received.copy()))
            self._changed.notify()
        return True

    def close(self, last: Action) -> None:
        """Enqueue a last command and accept nothing after it; what is queued stays in the queue."""
        with self._changed:
            if not self._closed:
                self._items.append(Command(last, self._received.copy()))
                self._closed = True
                self._changed.notify_all()

    def take(self, timeout_s: float) -> list[Received | Command]:
        """Return the oldest items; if there are none, wait until the timeout, a command or a large queue.

        The call also reports that the items of the call before are finished: until then they take room.
        """
        with self._changed:
            self.bytes -= self._taken_bytes
            self._taken_bytes = 0
            if not self._items and not self._closed:
                self._changed.wait(timeout_s)
            taken = []
            while self._items and self._taken_bytes < _BATCH_BYTES:
                item = self._items.popleft()
                taken.append(item)
                if isinstance(item, Received):
                    self._taken_bytes += len(item.payload) + _OVERHEAD_BYTES
            return taken

    def received(self) -> Counter[str]:
        """Return the number of received messages by topic, including those for which there was no room."""
        with self._changed:
            return self._received.copy()

    @property
    def finished(self) -> bool:
        """Whether the queue is closed and empty."""
        with self._changed:
            return self._closed and not self._items
