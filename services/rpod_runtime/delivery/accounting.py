"""Sequence accounting: what was received, recovered, missed, doubled or out of place, per publisher.

The rules are those of ICD section 2: numbers rise by one, so a gap is the number of missed messages. A number
far away from the last one is not a gap but a jump: probably a second publisher uses the same gid. Its message
is refused and reported, and the old sequence continues. If the old sequence does not continue, because the
publisher itself jumped, the new numbers are accepted after a few messages.
"""

from collections import Counter, OrderedDict, defaultdict
from dataclasses import dataclass
from threading import Lock

from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.rmw.wire import Attachment

Publication = tuple[str, bytes]
"""Key and gid, which identify one publisher's sequence."""

FARTHEST = 1000
"""Largest step between two sequence numbers that counts as a gap: twice the largest cache. More is a jump."""
LONGEST_GAP = 1_000_000
"""Largest confirmed jump, in sequence numbers, that counts as a gap: more than an hour of truth.

After a larger one the publisher has started its numbers again, and it is unknown how many messages were
missed.
"""
CONFIRMED = 3
"""Number of messages with rising numbers that confirm a jump, without a message of the old sequence
between."""
MOST_KEYS = 1000
"""Largest number of keys that are counted; messages of more keys are refused."""
MOST_PUBLICATIONS = 4096
"""Largest number of sequences that are remembered; of more the one that was silent longest is forgotten."""


class TooManyKeysError(MessageRejectedError):
    """A message of one more key than are counted."""

    def __init__(self, key: str) -> None:
        super().__init__(
            Reason.TOO_MANY,
            f"{key}: messages of {MOST_KEYS} keys at most are received; stop the one that publishes so many",
        )


class DuplicateError(MessageRejectedError):
    """A message whose number, or a later one, was already received."""

    def __init__(self, sequence: int) -> None:
        super().__init__(
            Reason.DUPLICATE, f"sequence number {sequence}, or a later one, was already received"
        )


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
            f"sequence number jumps from {jump}: more than {FARTHEST} numbers; stop a second publisher with "
            "the same gid, or restart this one",
        )


@dataclass
class Count:
    """Totals of one key."""

    received: int = 0
    missed: int = 0
    duplicates: int = 0
    recovered: int = 0
    """Number of received messages that were lost at first and then fetched from the publisher's cache."""


@dataclass
class _Elsewhere:
    """Numbers far away from the sequence, seen since the last message of the sequence."""

    last: int
    messages: int = 1


class SequenceAccount:
    """Counts per (key, gid), from the first number seen; an equal or lower number is a duplicate."""

    def __init__(self) -> None:
        self._last: OrderedDict[Publication, int] = OrderedDict()
        self._elsewhere: dict[Publication, _Elsewhere] = {}
        self._live: set[Publication] = set()
        self._gaps: Counter[Publication] = Counter()
        self._given_up: Counter[Publication] = Counter()
        self._lock = Lock()
        self.counts: dict[str, Count] = defaultdict(Count)
        self.forgotten = 0
        """Number of sequences that were forgotten because there were too many."""

    def take(self, key: str, attachment: Attachment, *, fetched: bool = False) -> None:
        """Account for one received message.

        A message that was ``fetched`` from a cache counts as recovered if a live message of its publisher was
        received before; otherwise it is history.

        Raises:
            DuplicateError: the number, or a later one, was already received.
            JumpError: the number is more than ``FARTHEST`` away from the last one.
            TooManyKeysError: there are too many keys.
        """
        if key not in self.counts and len(self.counts) >= MOST_KEYS:
            raise TooManyKeysError(key)
        publication = key, attachment.gid
        self._judge(publication, attachment.sequence, fetched=fetched)
        count = self.counts[key]
        count.received += 1
        if not fetched:
            self._live.add(publication)
        elif publication in self._live:
            count.recovered += 1
        self._last[publication] = attachment.sequence
        self._last.move_to_end(publication)
        self._elsewhere.pop(publication, None)
        if len(self._last) > MOST_PUBLICATIONS:
            self._forget()

    def restart(self, key: str, gid: bytes) -> None:
        """Forget a sequence: another publisher continues under the gid, with numbers of its own."""
        with self._lock:
            self._last.pop((key, gid), None)
            self._drop((key, gid))

    def _forget(self) -> None:
        """Forget the sequence that was silent longest; what was counted of it stays counted."""
        with self._lock:
            publication, _ = self._last.popitem(last=False)
            self._drop(publication)
            self.forgotten += 1

    def _drop(self, publication: Publication) -> None:
        self._elsewhere.pop(publication, None)
        self._live.discard(publication)
        self._gaps.pop(publication, None)
        self._given_up.pop(publication, None)

    def _judge(self, publication: Publication, sequence: int, *, fetched: bool) -> None:
        """Count a gap; raise if the number is not accepted."""
        last = self._last.get(publication)
        if last is None:
            return
        step = sequence - last
        if step > FARTHEST or (step < -FARTHEST and not fetched):
            if not self._is_confirmed(publication, sequence):
                raise JumpError(Jump(*publication, before=last, after=sequence))
            # The refused messages of the jump did arrive; numbers that went back are no gap.
            step = step - self._elsewhere[publication].messages if step <= LONGEST_GAP else 1
        elif step <= 0:
            self.counts[publication[0]].duplicates += 1
            raise DuplicateError(sequence)
        if step > 1:
            self._find(publication, self._gaps, step - 1)

    def _is_confirmed(self, publication: Publication, sequence: int) -> bool:
        """Return whether enough successive messages have had rising numbers after the jump."""
        elsewhere = self._elsewhere.get(publication)
        if elsewhere is None or sequence <= elsewhere.last:
            self._elsewhere[publication] = _Elsewhere(sequence)
            return False
        if elsewhere.messages + 1 >= CONFIRMED:
            return True
        elsewhere.last, elsewhere.messages = sequence, elsewhere.messages + 1
        return False

    def miss(self, publication: Publication, messages: int) -> None:
        """Count messages that the bus could not recover; a gap at a sequence's end is seen only so."""
        self._find(publication, self._given_up, messages)

    def _find(self, publication: Publication, finder: Counter[Publication], messages: int) -> None:
        """Count missed messages once although gaps and the bus both report them, in any order and thread."""
        with self._lock:
            before = max(self._gaps[publication], self._given_up[publication])
            finder[publication] += messages
            now = max(self._gaps[publication], self._given_up[publication])
            self.counts[publication[0]].missed += now - before
