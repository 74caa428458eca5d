"""A process that stood still knows it by its own clock, and which messages waited for it."""

from rpod_runtime.process.standing import StandWatch

UTC_NS, SECOND_NS = 10**18, 10**9


class Clock:
    def __init__(self):
        self.now_s = self.asleep_s = 0.0

    def watch(self):
        return StandWatch(
            lambda: self.now_s, lambda: self.now_s - self.asleep_s, lambda: UTC_NS + round(self.now_s * 1e9)
        )

    def run(self, watch, for_s):
        for _ in range(round(for_s / 0.05)):
            self.now_s += 0.05
            assert watch.look() is None


def test_a_process_that_runs_does_not_stand():
    clock = Clock()
    clock.run(clock.watch(), 5.0)


def test_messages_that_waited_are_told_from_later_ones():
    clock = Clock()
    watch = clock.watch()
    clock.run(watch, 1.0)
    clock.now_s += 4.0
    stand = watch.look()
    assert stand.length_s == 4.0
    assert "stood still for 4.0 s" in stand.text
    assert stand.holds_up(UTC_NS + 2 * SECOND_NS, arrival_s=5.0)
    assert not stand.holds_up(UTC_NS + 2 * SECOND_NS, arrival_s=0.9)  # before
    assert not stand.holds_up(UTC_NS + 6 * SECOND_NS, arrival_s=6.1)  # measured after it
    assert not stand.holds_up(UTC_NS, arrival_s=9.0)  # a clock that is behind


def test_a_machine_that_slept_stood_still():
    """Its monotonic clock stands meanwhile."""
    clock = Clock()
    watch = clock.watch()
    clock.run(watch, 1.0)
    clock.now_s += 60.0
    clock.asleep_s += 60.0
    stand = watch.look()
    assert stand.length_s == 60.0
    assert abs(stand.end_s - stand.begin_s) < 1e-9
    assert stand.holds_up(UTC_NS + 30 * SECOND_NS, arrival_s=1.01)


def test_a_thread_looks_while_the_process_waits():
    with StandWatch() as watch:
        assert watch.look() is None or watch.look().length_s >= 0.5
