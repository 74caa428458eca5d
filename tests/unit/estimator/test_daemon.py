"""What the daemon asks of its parts."""

from types import SimpleNamespace

import pytest

from rpod_estimator.daemon import _Service
from rpod_estimator.judging import Judging
from rpod_schemas.control import Accepted, ResetRequest
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.poses import make_pose

THREADS = {"judging": Judging(at_once=True), "held": SimpleNamespace()}


class Asked:
    """A part of the daemon that notes what it is asked."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def request_reset(self, _: ResetRequest) -> Accepted:
        self.asked.append("reset")
        return Accepted()

    def end_pauses(self) -> None:
        self.asked.append("end pauses")


def service(estimator: Asked, subscriptions: Asked, searches: Asked) -> _Service:
    parts = estimator, subscriptions, SimpleNamespace(), SimpleNamespace()
    return _Service(*parts, searches=searches, readings=(), **THREADS, in_lockstep=False)  # type: ignore[arg-type]


def test_a_reset_that_is_refused_changes_nothing():
    parts = Asked(), Asked(), Asked()
    with pytest.raises(ConfigurationError, match="poses are taken in 'chaser'"):
        service(*parts).reset(ResetRequest(pose=make_pose(), frame_id="pmd_optical"))
    assert [part.asked for part in parts] == [[], [], []]


def test_a_reset_ends_the_pauses_of_searches_in_the_main_loop_only():
    parts = Asked(), Asked(), Asked()
    service(*parts).reset(ResetRequest())
    assert [part.asked for part in parts] == [["reset"], ["reset"], []]


def test_readings_are_taken_in_while_no_frame_comes_but_not_in_lockstep():
    class Readings:
        taken = 0

        def take_in(self) -> None:
            self.taken += 1

    class Still(Asked):
        def tick(self, _: int) -> None:
            return None

        def unreported(self, *_: object) -> tuple[()]:
            return ()

    for in_lockstep, taken in ((False, 1), (True, 0)):
        readings = Readings()
        parts = Still(), Asked(), SimpleNamespace(), SimpleNamespace()
        rest = {"readings": (readings,), "in_lockstep": in_lockstep}
        made = _Service(*parts, searches=Asked(), **rest, **THREADS)  # type: ignore[arg-type]
        made.tick(1)
        assert readings.taken == taken
