"""Sequence accounting: what was received, recovered, missed and doubled, per publisher (ICD section 2)."""

from collections import Counter, defaultdict
from dataclasses import dataclass
from enum import Enum, auto
from threading import Lock

from rpod_schemas.wire import Attachment

Publication = tuple[str, bytes]
"""Key and gid: one publisher's sequence."""


class Arrival(Enum):
    """How a message stands in its publisher's sequence."""

    NEXT = auto()
    DUPLICATE = auto()


@dataclass
class Count:
    """Totals of one key."""

    received: int = 0
    missed: int = 0
    duplicates: int = 0
    recovered: int = 0
    """Of those received: lost at first, then fetched from the publisher's cache."""


class SequenceAccount:
    """Counts per (key, gid), from the first number seen; an equal or lower number is a duplicate."""

    def __init__(self) -> None:
        self._last: dict[Publication, int] = {}
        self._live: set[Publication] = set()
        self._gaps: Counter[Publication] = Counter()
        self._given_up: Counter[Publication] = Counter()
        self._lock = Lock()
        self.counts: dict[str, Count] = defaultdict(Count)

    def take(self, key: str, attachment: Attachment, *, fetched: bool = False) -> Arrival:
        """Account for one arrival.

        What was ``fetched`` out of a cache is recovered if its publisher was heard live before; until
        then it is history.
        """
        count, publication = self.counts[key], (key, attachment.gid)
        last = self._last.get(publication)
        if last is not None and attachment.sequence <= last:
            count.duplicates += 1
            return Arrival.DUPLICATE
        if last is not None and attachment.sequence > last + 1:
            self._find(publication, self._gaps, attachment.sequence - last - 1)
        count.received += 1
        if not fetched:
            self._live.add(publication)
        elif publication in self._live:
            count.recovered += 1
        self._last[publication] = attachment.sequence
        return Arrival.NEXT

    def miss(self, publication: Publication, messages: int) -> None:
        """Take what the bus gave up: at the end of a sequence no later number would tell."""
        self._find(publication, self._given_up, messages)

    def _find(self, publication: Publication, finder: Counter[Publication], messages: int) -> None:
        """Count once what both ways find, in whatever order, from several threads."""
        with self._lock:
            before = max(self._gaps[publication], self._given_up[publication])
            finder[publication] += messages
            now = max(self._gaps[publication], self._given_up[publication])
            self.counts[publication[0]].missed += now - before
