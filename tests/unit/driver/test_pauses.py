"""A driver that waits for its next frame yields often enough to be stopped."""

import time

from rpod_driver.pauses import paused_until


def test_a_long_wait_yields_nothing_twice_a_second_and_ends_in_time():
    begun_s = time.monotonic()
    items = list(paused_until(begun_s + 1.2))
    assert items == [None, None]
    assert time.monotonic() >= begun_s + 1.2


def test_a_time_that_has_passed_is_not_waited_for():
    assert list(paused_until(time.monotonic() - 1.0)) == []
