"""The condition of a link at a time, which follows from the faults that are active."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import prod
from random import Random

CHUNK_BYTES = 16_384
"""Largest number of bytes that are passed on at a time."""
_PACKET_BYTES = 1_448
_TIMEOUT_S, _ROUND_TRIP_S = 0.2, 1e-3
MBIT = 125_000.0
"""Bytes of a megabit."""


@dataclass(frozen=True)
class Condition:
    """Delay, loss and limits of a link."""

    delay_s: float = 0.0
    """Time that each byte takes longer, s, in each direction."""
    loss: float = 0.0
    """Share of the packets that are lost and sent again."""
    rate_B_s: float | None = None
    """Largest number of bytes a second, in each direction; None for no limit."""
    stalled: bool = False
    """Whether the link stands still; nothing is lost."""
    dead: bool = False
    """Whether all that is sent is lost, without a word to either side."""
    cut: bool = False
    """Whether each connection is closed at once."""

    def lost_s(self, size: int, *, more: bool, random: Random) -> float:
        """Return the time that the lost packets of some data cost, s.

        A lost packet costs the time in which TCP sends it again: a round trip where more data follow, whose
        arrival tells the sender of the gap, else the least time-out of Linux (RFC 6298; ``TCP_RTO_MIN``
        200 ms).
        """
        if not self.loss:
            return 0.0
        lost = [random.random() < self.loss for _ in range(-(-size // _PACKET_BYTES))]
        if not any(lost):
            return 0.0
        return _TIMEOUT_S if lost[-1] and not more else max(2.0 * self.delay_s, _ROUND_TRIP_S)


GOOD = Condition()


def condition_of(faults: Iterable[tuple[str, float | None]]) -> Condition:
    """Return the condition of a link with faults, by name and size; delays add up, the lowest rate counts."""
    sizes: dict[str, list[float]] = {}
    for name, size in faults:
        sizes.setdefault(name, []).append(size or 0.0)
    return Condition(
        delay_s=sum(sizes.get("link_delay", [])),
        loss=1.0 - prod(1.0 - share for share in sizes.get("link_loss", [])),
        rate_B_s=min((MBIT * rate for rate in sizes.get("link_rate", [])), default=None),
        stalled="link_stall" in sizes,
        dead="link_half_open" in sizes,
        cut="link_cut" in sizes,
    )
