"""Truth by the wall clock: a clock that nobody waits for."""

from types import SimpleNamespace

import pytest

from rpod_motion import daemon

SECOND_NS = 1_000_000_000


class Clock:
    """A stop event and the time: to wait is to let the time pass."""

    def __init__(self) -> None:
        self.now_ns = 5 * SECOND_NS
        self.last_s = 0.0

    def wait(self, seconds: float) -> bool:
        self.now_ns += round(seconds * SECOND_NS)
        self.last_s = seconds
        return False

    def is_set(self) -> bool:
        return False

    def time_ns(self) -> int:
        return self.now_ns


def test_ticks_that_span_half_the_lead_are_published_together_and_none_before_its_lead(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = Clock()
    monkeypatch.setattr(daemon, "time", clock)
    begin_ns, ahead_ms = clock.now_ns + SECOND_NS, []
    truth = SimpleNamespace(
        publish=lambda tick: ahead_ms.append((begin_ns + 4_000_000 * tick - clock.now_ns) / 1e6),
        stamp_ns=lambda tick: begin_ns + 4_000_000 * tick,
    )
    daemon._play_by_the_wall(SimpleNamespace(stop=clock), truth, range(7), lead_s=0.02)  # type: ignore[arg-type]
    assert ahead_ms == pytest.approx([12.0, 16.0, 20.0, 12.0, 16.0, 20.0, 20.0], abs=1e-3)


@pytest.mark.parametrize("lead_s", [0.0, 400.0])
def test_truth_comes_so_long_before_its_stamp_and_the_play_ends_at_the_last_one(
    lead_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock()
    monkeypatch.setattr(daemon, "time", clock)
    begin_s = clock.now_ns / SECOND_NS
    published: list[tuple[int, float]] = []
    truth = SimpleNamespace(
        publish=lambda tick: published.append((tick, clock.now_ns / SECOND_NS - begin_s)),
        stamp_ns=lambda tick: round((begin_s + 1000.0 * tick) * SECOND_NS),
    )
    daemon._play_by_the_wall(SimpleNamespace(stop=clock), truth, range(3), lead_s=lead_s)  # type: ignore[arg-type]
    assert [tick for tick, _ in published] == [0, 1, 2]
    assert [at_s for _, at_s in published] == pytest.approx([0.0, 1000.0 - lead_s, 2000.0 - lead_s], abs=1e-6)
    assert clock.last_s == lead_s
