"""Counters and health of a service, and the diagnostics that carry them."""

import time
from collections import Counter
from collections.abc import Callable, Mapping
from threading import Lock

from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.types import Diagnostic, Health

MOST_NAMES = 3000
"""Largest number of counters, and of texts; names that come later are counted together, by their group."""
_REMIND_S = 60.0
"""Time between two lines about rejected messages of one kind."""


class HealthBook:
    """Counters, measured values and health of a service. Safe to use from several threads.

    Counters are named ``group/what``: ``rejected/pmd/depth/image_raw/late``, ``published/pmd/...``.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._lock = Lock()
        self._counters: Counter[str] = Counter()
        self._measures: dict[str, float] = {}
        self._texts: dict[str, str] = {}
        self._warning = ""
        self._alarms: dict[str, str] = {}
        self._told_s: dict[str, float] = {}
        self._rejections: dict[str, str] = {}
        self._level, self._message = Health.OK, "starting"
        self._check: Callable[[], tuple[Health, str]] | None = None
        self._changed = True

    @staticmethod
    def _known(name: str, book: Mapping[str, object]) -> str:
        """Return the name, or that of a common entry once there are many names, which bounds the memory."""
        return name if name in book or len(book) < MOST_NAMES else f"{name.split('/', 1)[0]}/others"

    def count(self, name: str, amount: int = 1) -> None:
        """Add an amount to a counter."""
        with self._lock:
            self._counters[self._known(name, self._counters)] += amount

    def put(self, name: str, value: int) -> None:
        """Set a counter whose value is kept elsewhere."""
        with self._lock:
            self._counters[self._known(name, self._counters)] = value

    def measure(self, name: str, value: float) -> None:
        """Set a measured value; its name ends with the unit."""
        with self._lock:
            self._measures[name] = value

    def reject(self, topic: str, rejection: MessageRejectedError | Reason) -> bool:
        """Count a rejected message by topic and reason; return whether to write a line about it.

        A line is due for the first one of its kind, and then once a minute.
        """
        reason = rejection if isinstance(rejection, Reason) else rejection.reason
        with self._lock:
            name = self._known(f"rejected/{topic}/{reason}", self._counters)
            self._counters[name] += 1
            self._rejections[self._known(topic, self._rejections)] = str(rejection)
            told_s, now_s = self._told_s.get(name), time.monotonic()
            due = told_s is None or now_s - told_s >= _REMIND_S
            if due:
                self._told_s[name] = now_s
            self._changed |= told_s is None
        return due

    def rejection(self, topic: str) -> str:
        """Return why the last rejected message of a topic was rejected; empty if none was."""
        with self._lock:
            return self._rejections.get(topic, "")

    def note_command(self, verb: str, request: str, asker: str = "") -> None:
        """Count an accepted command and keep its text, so that a log shows which commands were given.

        ``asker`` is the name of who gave it, if certificates tell.
        """
        with self._lock:
            self._counters[f"commands/{verb}"] += 1
            self._texts[f"command/{verb}"] = request
            if asker:
                self._texts[f"command_by/{verb}"] = asker
            self._changed = True

    def warn(self, name: str, text: str) -> None:
        """Add a text for the operator to the diagnostics; the level stays at least WARN from now on."""
        with self._lock:
            name = self._known(name, self._texts)
            self._texts[name] = text
            self._warning = f"look at {name}"
            self._changed = True

    def alarm(self, name: str, text: str) -> None:
        """Set an alarm. It keeps the level at least at WARN until an empty text removes it."""
        with self._lock:
            self._changed |= text != self._alarms.get(name, "")
            if text:
                self._alarms[name] = text
            else:
                self._alarms.pop(name, None)

    def set_text(self, name: str, text: str) -> None:
        """Set a text for the operator in the diagnostics; an empty one is removed."""
        with self._lock:
            if text:
                self._texts[name] = text
            else:
                self._texts.pop(name, None)

    def report(self, level: Health, message: str) -> None:
        """Set the level and the message of the service; a change is published at once."""
        with self._lock:
            self._changed |= (level, message) != (self._level, self._message)
            self._level, self._message = level, message

    def watch(self, check: Callable[[], tuple[Health, str]]) -> None:
        """Take level and message from ``check`` at each diagnostic, even if the main loop hangs."""
        self._check = check

    def take_change(self) -> bool:
        """Return whether anything changed since the last call."""
        with self._lock:
            changed, self._changed = self._changed, False
        return changed

    def counters(self) -> dict[str, int]:
        """Return a copy of all counters."""
        with self._lock:
            return dict(sorted(self._counters.items()))

    def diagnostic(self, stamp_ns: int) -> Diagnostic:
        """Return the current diagnostic."""
        level, message = self._check() if self._check else (self._level, self._message)
        values = {name: str(value) for name, value in self.counters().items()}
        with self._lock:
            values |= {name: f"{value:.6g}" for name, value in self._measures.items()} | self._texts
            values |= self._alarms
            warning = "; ".join(filter(None, [self._warning, *(f"look at {name}" for name in self._alarms)]))
        if warning:
            level, message = max(level, Health.WARN), f"{message}; {warning}"
        return Diagnostic(stamp_ns=stamp_ns, name=self.name, level=level, message=message, values=values)
