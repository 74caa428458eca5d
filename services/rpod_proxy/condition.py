"""The condition of a link at a time, which follows from the faults that are active."""

from collections.abc import Iterable
from dataclasses import dataclass

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


GOOD = Condition()


def condition_of(faults: Iterable[tuple[str, float | None]]) -> Condition:
    """Return the condition of a link with faults, by name and size; delays add up, the lowest rate counts."""
    sizes: dict[str, list[float]] = {}
    for name, size in faults:
        sizes.setdefault(name, []).append(size or 0.0)
    kept = 1.0
    for share in sizes.get("link_loss", []):
        kept *= 1.0 - share
    return Condition(
        delay_s=sum(sizes.get("link_delay", [])),
        loss=1.0 - kept,
        rate_B_s=min((MBIT * rate for rate in sizes.get("link_rate", [])), default=None),
        stalled="link_stall" in sizes,
        dead="link_half_open" in sizes,
        cut="link_cut" in sizes,
    )
