"""Sequence accounting: what was received, missed and doubled, per publisher (ICD section 2)."""

from collections import defaultdict
from dataclasses import dataclass
from enum import Enum, auto

from rpod_schemas.wire import Attachment


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


class SequenceAccount:
    """Counts per (key, gid), from the first number seen; an equal or lower number is a duplicate."""

    def __init__(self) -> None:
        self._last: dict[tuple[str, bytes], int] = {}
        self.counts: dict[str, Count] = defaultdict(Count)

    def take(self, key: str, attachment: Attachment) -> Arrival:
        """Account for one arrival."""
        count = self.counts[key]
        last = self._last.get((key, attachment.gid))
        if last is not None and attachment.sequence <= last:
            count.duplicates += 1
            return Arrival.DUPLICATE
        count.missed += attachment.sequence - last - 1 if last is not None else 0
        count.received += 1
        self._last[key, attachment.gid] = attachment.sequence
        return Arrival.NEXT
