"""Sequence accounting: what was received, recovered, missed, doubled or out of place, per publisher.

The rules are those of ICD section 2: numbers rise by one, so that a gap is what was missed. A number far
away from the last one is no gap but a second sequence under one identity: it is refused and told, and the
sequence goes on. Where the sequence does not go on, because the publisher really jumped, the new numbers
are taken after a few messages.
"""

from collections import Counter, defaultdict
from dataclasses import dataclass
from threading import Lock

from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.wire import Attachment

Publication = tuple[str, bytes]
"""Key and gid: one publisher's sequence."""

FARTHEST = 1000
"""Numbers between two messages that are a gap: twice the largest cache; more is a jump."""
LONGEST_GAP = 1_000_000
"""A confirmed jump up to this many numbers is a gap: over an hour of truth was missed.

After a longer one the publisher counts anew, and nobody knows what was missed.
"""
CONFIRMED = 3
"""Messages with rising numbers after a jump, none of the old sequence between them, that confirm it."""


class DuplicateError(MessageRejectedError):
    """A message whose number, or a later one, has been received."""

    def __init__(self, sequence: int) -> None:
        super().__init__(Reason.DUPLICATE, f"sequence {sequence}")


@dataclass(frozen=True)
class Jump:
    """A number far away from the last one of its publisher."""

    key: str
    gid: bytes
    before: int
    """Last number of the sequence."""
    after: int
    """Number of the message that was refused."""

    def __str__(self) -> str:
        return f"{self.before} to {self.after}, publisher {self.gid.hex()}"


class JumpError(MessageRejectedError):
    """A message whose number is too far away from the last one to be of the same sequence."""

    def __init__(self, jump: Jump) -> None:
        self.jump = jump
        super().__init__(
            Reason.JUMP,
            f"sequence from {jump}: limit {FARTHEST} numbers; does a second publisher use the same gid?",
        )


@dataclass
class Count:
    """Totals of one key."""

    received: int = 0
    missed: int = 0
    duplicates: int = 0
    recovered: int = 0
    """Those of the received ones that were lost at first, then fetched from the publisher's cache."""


@dataclass
class _Elsewhere:
    """Numbers far away from the sequence that were seen since it was last heard."""

    last: int
    messages: int = 1


class SequenceAccount:
    """Counts per (key, gid), from the first number seen; an equal or lower number is a duplicate."""

    def __init__(self) -> None:
        self._last: dict[Publication, int] = {}
        self._elsewhere: dict[Publication, _Elsewhere] = {}
        self._live: set[Publication] = set()
        self._gaps: Counter[Publication] = Counter()
        self._given_up: Counter[Publication] = Counter()
        self._lock = Lock()
        self.counts: dict[str, Count] = defaultdict(Count)

    def take(self, key: str, attachment: Attachment, *, fetched: bool = False) -> None:
        """Account for one arrival.

        What was ``fetched`` out of a cache is recovered if its publisher was heard live before; until
        then it is history.

        Raises:
            DuplicateError: the number has been received, or a later one.
            JumpError: the number is more than ``FARTHEST`` away from the last one.
        """
        publication = key, attachment.gid
        self._judge(publication, attachment.sequence, fetched=fetched)
        count = self.counts[key]
        count.received += 1
        if not fetched:
            self._live.add(publication)
        elif publication in self._live:
            count.recovered += 1
        self._last[publication] = attachment.sequence
        self._elsewhere.pop(publication, None)

    def _judge(self, publication: Publication, sequence: int, *, fetched: bool) -> None:
        """Count a gap; raise where the number is not taken."""
        last = self._last.get(publication)
        if last is None:
            return
        step = sequence - last
        if step > FARTHEST or (step < -FARTHEST and not fetched):
            if not self._is_confirmed(publication, sequence):
                raise JumpError(Jump(*publication, before=last, after=sequence))
            # What was refused on the way did arrive; numbers that went back tell of no gap.
            step = step - self._elsewhere[publication].messages if step <= LONGEST_GAP else 1
        elif step <= 0:
            self.counts[publication[0]].duplicates += 1
            raise DuplicateError(sequence)
        if step > 1:
            self._find(publication, self._gaps, step - 1)

    def _is_confirmed(self, publication: Publication, sequence: int) -> bool:
        """Return whether enough numbers have risen elsewhere, one after the other."""
        elsewhere = self._elsewhere.get(publication)
        if elsewhere is None or sequence <= elsewhere.last:
            self._elsewhere[publication] = _Elsewhere(sequence)
            return False
        if elsewhere.messages + 1 >= CONFIRMED:
            return True
        elsewhere.last, elsewhere.messages = sequence, elsewhere.messages + 1
        return False

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
