"""How much arrives on a link, and how old it is: what the diagnostics tell of images and clouds."""

import time
from threading import Lock


class Flow:
    """Bytes and ages of the messages of bulky topics. Safe to use from several threads."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._bytes: dict[str, int] = {}
        self._age_s: dict[str, float] = {}
        self._since_s = time.monotonic()

    def add(self, topic: str, size: int, age_s: float) -> None:
        """Add a message: its size, bytes, and the time since it was published, s, by both hosts' clocks."""
        with self._lock:
            self._bytes[topic] = self._bytes.get(topic, 0) + size
            self._age_s[topic] = max(age_s, self._age_s.get(topic, age_s))

    def take(self, now_s: float | None = None) -> dict[str, float]:
        """Return rate and greatest age since the last call, by the names of diagnostics.

        A topic that was heard once keeps its rate, 0 while nothing comes; it has no age then.
        """
        now_s = time.monotonic() if now_s is None else now_s
        with self._lock:
            lasted_s, self._since_s = max(now_s - self._since_s, 1e-3), now_s
            found = {f"link_mbit_s/{topic}": 8e-6 * size / lasted_s for topic, size in self._bytes.items()}
            found |= {f"link_age_s/{topic}": age_s for topic, age_s in self._age_s.items()}
            self._bytes = dict.fromkeys(self._bytes, 0)
            self._age_s = {}
        return found
