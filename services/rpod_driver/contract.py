"""Tests for pytest that every driver must pass: derive a class, and say which driver.

    from rpod_driver.contract import DriverContract

    class TestMyCamera(DriverContract):
        kind = "pmd"

        @pytest.fixture
        def driver(self):
            return MyCamera(...)

The frames go through the same judgement as ``rpod driver check``, without a bus. Truth does not come, so that
what needs it is not checked.
"""

import time
from contextlib import contextmanager
from typing import Any, ClassVar

import pytest

from rpod_driver.check import CheckResult, Level, Observations, Observer, Options, judge
from rpod_driver.check.live import observed_node
from rpod_driver.ports import Adjustable, Counted, Drops, Paced, Synchronised
from rpod_runtime.process.awake import TickingClock
from rpod_runtime.sensors import open_publisher
from rpod_schemas.poses import make_pose
from rpod_schemas.types import SensorSync

__all__ = ["DriverContract"]

_AT_ONCE_S = 0.2
_ITEM_S = 1.5
"""Longest wait for an item: a driver yields None at least once a second while no frame comes."""


class DriverContract:
    """Tests of one driver; a derived class sets ``kind`` and has a fixture ``driver``."""

    kind: ClassVar[str]
    """Kind of the sensor."""
    duration_s: ClassVar[float] = 3.0
    """Time for which frames are watched, s."""
    options: ClassVar[Options] = Options()
    """Declared properties of the sensor, such as its nominal rate."""
    expected: ClassVar[frozenset[str]] = frozenset()
    """Names of the lines that may fail, with a reason beside it; a recording cannot have stamps of now."""

    @pytest.fixture
    def driver(self) -> Any:
        """Return the driver; derived classes have their own."""
        raise NotImplementedError("give the class a fixture `driver` that returns the driver")

    def test_the_check_finds_nothing_wrong(self, driver: Any) -> None:
        """Frames of a few seconds, checked as ``rpod driver check`` does."""
        results = judge(self._watched(driver))
        wrong = [each for each in results if each.level is Level.FAIL and each.line not in self.expected]
        assert not wrong, "\n".join(_line(each) for each in wrong)

    def test_frames_come_and_no_item_takes_long(self, driver: Any) -> None:
        """The host can stop and can detect a silent sensor only between two items."""
        with connected(driver), TickingClock() as clock:
            frames, items = 0, iter(driver.frames())
            end_s = time.monotonic() + self.duration_s
            while time.monotonic() < end_s:
                asked_s = clock.now_s()
                item = next(items, driver)
                waited_s = clock.now_s() - asked_s
                assert waited_s < _ITEM_S, f"an item took {waited_s:.1f} s; yield None once a second"
                if item is driver:
                    break  # the source has ended
                frames += item is not None
        assert frames, f"no frame in {self.duration_s:g} s"

    def test_it_can_be_connected_again_after_it_was_closed(self, driver: Any) -> None:
        """The host does so after each error."""
        for _ in range(2):
            with connected(driver):
                assert next((item for item in driver.frames() if item is not None), None) is not None

    def test_what_it_tells_of_itself_comes_at_once(self, driver: Any) -> None:
        """The host asks each second, in the thread of its diagnostics."""
        with connected(driver), TickingClock() as clock:
            asked_s = clock.now_s()
            if isinstance(driver, Synchronised):
                assert isinstance(driver.sync(), SensorSync)
            if isinstance(driver, Counted):
                assert isinstance(driver.drops(), Drops)
            if isinstance(driver, Paced):
                assert isinstance(driver.due_s(), float)
            assert clock.now_s() - asked_s < _AT_ONCE_S

    def test_settings_can_be_written_as_they_were_read(self, driver: Any) -> None:
        """So the host can restore them."""
        if not isinstance(driver, Adjustable):
            pytest.skip("the driver has no settings")
        with connected(driver):
            before = dict(driver.settings())
            driver.apply(before)
            assert dict(driver.settings()) == before

    def _watched(self, driver: Any) -> Observations:
        observer = Observer(self.kind, "sensor", self.options)
        with connected(driver) as info:
            publisher = open_publisher(observed_node(observer), self.kind, "sensor", make_pose())
            if info is not None:
                publisher.announce(info)
            end_s = time.monotonic() + self.duration_s
            for frame in driver.frames():
                if frame is not None:
                    publisher.publish(frame)
                if time.monotonic() >= end_s:
                    break
        return observer.end(time.time_ns())


@contextmanager
def connected(driver: Any) -> Any:
    """Connect a driver, hand out its info, and close it."""
    info = driver.connect()
    try:
        yield info
    finally:
        driver.close()


def _line(result: CheckResult) -> str:
    return f"{result.line}: {result.text}; {result.remedy}"
