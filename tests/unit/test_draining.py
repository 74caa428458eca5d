"""A service is stopped when its messages are in the log."""

from collections import deque

import pytest

from rpod.play import draining
from rpod.play.draining import await_logged
from rpod_runtime import QueryFailedError
from rpod_schemas.control import StatusReply

PUBLISHED = {"published/truth/odometry": 100, "published/slow/image_raw": 7}


class Bus:
    """Stands for a node; the logger gives one answer after the other, and repeats the last one."""

    def __init__(self, *heard: dict[str, int] | None, published: dict[str, int] | None = PUBLISHED) -> None:
        self._heard, self._published = deque(heard), published
        self.asked = 0

    def ask(self, instance, _verb, _reply, **_):
        counters = self._published
        if instance == "logger":
            self.asked += 1
            counters = self._heard.popleft() if len(self._heard) > 1 else self._heard[0]
        if counters is None:
            raise QueryFailedError("key", "no answer")
        return StatusReply(
            name=instance, version="test", state="running", uptime_s=1.0, counters=counters, configuration={}
        )


class Clock:
    """A clock by which each look takes half a second, whatever the machine does."""

    def __init__(self, _longest_s: float) -> None:
        self._now_s = 0.0

    def now_s(self) -> float:
        self._now_s += 0.5
        return self._now_s


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    monkeypatch.setattr(draining, "_POLL_S", 0.0)
    monkeypatch.setattr(draining, "AwakeClock", Clock)


def received(count: int, missed: int = 0) -> dict[str, int]:
    return {"received/truth/odometry": count, "missed/truth/odometry": missed}


@pytest.mark.parametrize("last", [received(100), received(98, missed=2)])
def test_the_messages_are_waited_for_also_while_the_logger_does_not_answer(last):
    bus = Bus(received(40), None, received(60), last)
    assert await_logged(bus, "motion", "logger", check=lambda: None)
    assert bus.asked == 4


@pytest.mark.parametrize("heard", [received(40), None], ids=["without progress", "without answer"])
def test_the_wait_ends_and_is_told_where_nothing_comes(heard, caplog):
    assert not await_logged(Bus(heard), "motion", "logger", check=lambda: None)
    assert "motion is stopped, but the logger lacks" in caplog.text


def test_a_service_that_does_not_say_what_it_has_published_is_told(caplog):
    bus = Bus(received(100), published=None)
    assert not await_logged(bus, "motion", "logger", check=lambda: None)
    assert "motion does not say what it has published" in caplog.text
    assert not bus.asked


def test_nobody_waits_for_a_logger_that_has_died():
    def check() -> None:
        raise RuntimeError("died")

    with pytest.raises(RuntimeError):
        await_logged(Bus(received(40)), "motion", "logger", check=check)


def test_an_answer_that_is_missed_first_does_not_hide_the_progress_after_it():
    bus = Bus(None, *(received(10 + number) for number in range(30)), received(100))
    assert await_logged(bus, "motion", "logger", check=lambda: None)
