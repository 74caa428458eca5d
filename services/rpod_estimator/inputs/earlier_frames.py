"""Frames that are those of an earlier time: a recording, or a ring of buffers, that is sent in a loop.

Their stamps are new, so that a target seems to move again as it did before. Noise is never identical: a frame
whose content equals that of an earlier one, to the bit, was not measured at its stamp.
"""

from hashlib import blake2b

_KEPT = 8192
"""Frames that are remembered: three minutes at 45 Hz, and 1 MB of memory."""
_DIGEST = 16


class EarlierFrames:
    """Finds the frame of one sensor that equals the newest one."""

    def __init__(self) -> None:
        self._numbers: dict[bytes, int] = {}
        self._taken = 0
        self.in_a_row = 0
        """Number of successive frames, up to the newest, that equal earlier ones."""
        self.back = 0
        """How many frames before the newest one its like was; 0 if there was none."""

    def take(self, content: memoryview) -> None:
        """Take a frame's content, without its stamp. A frame may equal the one before for other reasons."""
        digest = blake2b(content, digest_size=_DIGEST).digest()
        self._taken += 1
        before = self._numbers.pop(digest, self._taken)
        self.back = self._taken - before if self._taken - before > 1 else 0
        self.in_a_row = self.in_a_row + 1 if self.back else 0
        self._numbers[digest] = self._taken
        if len(self._numbers) > _KEPT:
            del self._numbers[next(iter(self._numbers))]

    @property
    def text(self) -> str:
        """What the newest frame repeats, with the remedy; empty if it is new."""
        if not self.back:
            return ""
        return (
            f"it is the frame {self.back} before it, to the bit: a recording or a ring of buffers is sent in "
            "a loop, under new stamps; restart the sensor's driver, or play recordings once"
        )
