"""What the daemon asks of its parts."""

from types import SimpleNamespace

import pytest

from rpod_estimator.daemon import _Service
from rpod_schemas.control import Accepted, ResetRequest
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.poses import make_pose


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
    return _Service(estimator, subscriptions, SimpleNamespace(), SimpleNamespace(), searches=searches)  # type: ignore[arg-type]


def test_a_reset_that_is_refused_changes_nothing():
    parts = Asked(), Asked(), Asked()
    with pytest.raises(ConfigurationError, match="poses are taken in 'chaser'"):
        service(*parts).reset(ResetRequest(pose=make_pose(), frame_id="pmd_optical"))
    assert [part.asked for part in parts] == [[], [], []]


def test_a_reset_ends_the_pauses_of_searches_in_the_main_loop_only():
    parts = Asked(), Asked(), Asked()
    service(*parts).reset(ResetRequest())
    assert [part.asked for part in parts] == [["reset"], ["reset"], []]
