"""Gaps of a device's frame counter."""

from rpod_driver.gaps import GapCounter


def test_missing_numbers_are_counted_within_a_connection_only():
    gaps = GapCounter()
    for number in (3, 4, 7, None, 9, 9, 10):
        gaps.take(number)
    assert gaps.lost == 2
    gaps.begin()
    gaps.take(500)
    gaps.take(502)
    assert gaps.lost == 3
