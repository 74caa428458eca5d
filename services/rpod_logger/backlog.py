"""The queue between the bus and the disk: bounded in bytes, and what does not fit is counted.

The bus's threads put and never wait. The writer's thread takes. Commands stand in the same queue, so
that a file ends exactly between two messages, with the counts of that moment.
"""

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from threading import Condition

from rpod_runtime import Received

_OVERHEAD_BYTES = 512
"""Memory of a queued message beside its payload."""
_BATCH_BYTES = 4 << 20
"""For so much the writer is woken, and so much it takes at once; for less it comes by itself, so that not
each message costs a wake-up."""


Action = Callable[[Counter[str]], None]
"""Gets the messages received until it was asked for, by topic."""


@dataclass(frozen=True)
class Command:
    """Something for the writer's thread to do when everything before it is done."""

    action: Action
    received: Counter[str]


class Backlog:
    """Messages and commands in order of arrival."""

    def __init__(self, capacity_bytes: int) -> None:
        self.capacity_bytes = capacity_bytes
        self.bytes = 0
        """Queued, and in the writer's hands."""
        self.high_water_bytes = 0
        self._taken_bytes = 0
        self._received: Counter[str] = Counter()
        self._items: deque[Received | Command] = deque()
        self._changed = Condition()
        self._closed = False

    def put(self, received: Received) -> bool:
        """Enqueue a message; return False where there was no room. After the close nothing is taken."""
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
        """Enqueue a command, for which there is always room; return False after the close."""
        with self._changed:
            if self._closed:
                return False
            self._items.append(Command(action, self._received.copy()))
            self._changed.notify()
        return True

    def close(self, last: Action) -> None:
        """Take nothing more after a last command; what is queued stays."""
        with self._changed:
            if not self._closed:
                self._items.append(Command(last, self._received.copy()))
                self._closed = True
                self._changed.notify_all()

    def take(self, timeout_s: float) -> list[Received | Command]:
        """Return the oldest items; where there is none wait, and look again at the timeout or at a command.

        Who comes again is done with what it took before: until then that takes room.
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
        """Return the messages received until now, by topic, those too for which there was no room."""
        with self._changed:
            return self._received.copy()

    @property
    def finished(self) -> bool:
        """Whether the queue is closed and empty."""
        with self._changed:
            return self._closed and not self._items
