"""Truth by the wall clock: a clock that nobody waits for."""

import time
from types import SimpleNamespace

import pytest

from rpod_motion.daemon import _play_by_the_wall

SECOND_NS = 1_000_000_000


class Waits:
    """A stop event that notes what is waited for, and does not wait."""

    def __init__(self) -> None:
        self.asked_s: list[float] = []

    def wait(self, seconds: float) -> bool:
        self.asked_s.append(seconds)
        return False

    def is_set(self) -> bool:
        return False


@pytest.mark.parametrize("lead_s", [0.0, 400.0])
def test_truth_comes_so_long_before_its_stamp_and_the_play_ends_at_the_last_one(lead_s: float) -> None:
    now_ns, stop = time.time_ns(), Waits()
    published: list[int] = []
    truth = SimpleNamespace(publish=published.append, stamp_ns=lambda tick: now_ns + tick * 1000 * SECOND_NS)
    _play_by_the_wall(SimpleNamespace(stop=stop), truth, range(3), lead_s=lead_s)  # type: ignore[arg-type]
    assert published == [0, 1, 2]
    first_s, second_s = (1000.0 - lead_s, 2000.0 - lead_s)
    assert stop.asked_s == pytest.approx([first_s, second_s, lead_s], abs=100.0)
    assert stop.asked_s[-1] == lead_s
