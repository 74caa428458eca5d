"""Processes in reserve, and how the service manager treats them."""

import subprocess
import sys
from threading import Event

import pytest
from pydantic import ValidationError

from rpod.up.reserve import AFTER_S, PAUSE_S, Reserve
from rpod_runtime.errors import NotNeededError
from rpod_runtime.process import reserve as waiting
from rpod_runtime.process.notify import manager
from rpod_schemas.config.facility.hosts import FacilityService

READER = "import sys; sys.exit(7 if sys.stdin.read(1) else 0)"
ENDS = "import sys; sys.exit(3)"


@pytest.fixture
def _in_reserve(monkeypatch):
    monkeypatch.setenv(waiting.RESERVE, "1")
    monkeypatch.setattr(waiting, "called", Event())


@pytest.fixture
def starts():
    """Function that starts a process, and what it started; what is left of it ends with the test."""
    started = []

    def spawn(program=READER):
        started.append(subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE))
        return started[-1]

    yield spawn, started
    for process in started:
        process.stdin.close()
        process.wait()


def test_a_reserve_starts_when_its_service_has_worked_for_a_while_and_is_called_by_its_input(starts):
    spawn, started = starts
    reserve = Reserve("estimator", spawn)
    reserve.update(AFTER_S / 2.0)
    assert (reserve.state, started) == ("none", [])
    assert reserve.take() is None

    reserve.update(AFTER_S)
    reserve.update(AFTER_S)
    assert (reserve.state, reserve.pid, len(started)) == ("starting", started[0].pid, 1)
    reserve.warm()
    assert reserve.state == "ready"
    assert reserve.take() is started[0]
    assert started[0].wait(20.0) == 7
    assert reserve.state == "none"


def test_a_reserve_that_is_not_needed_ends_and_one_that_fails_is_not_tried_again_at_once(starts, monkeypatch):
    spawn, started = starts
    reserve = Reserve("estimator", spawn)
    reserve.update(AFTER_S)
    reserve.drop()
    assert started[0].returncode is not None

    failing = Reserve("estimator", lambda: spawn(ENDS))
    failing.update(AFTER_S)
    started[1].wait(20.0)
    for _ in range(3):
        failing.update(AFTER_S)
    assert len(started) == 2
    monkeypatch.setattr("rpod.up.reserve.time.monotonic", lambda now_s=failing._due_s: now_s + PAUSE_S)
    failing.update(AFTER_S)
    assert len(started) == 3


@pytest.mark.usefixtures("_in_reserve")
def test_a_process_in_reserve_waits_for_its_turn_once(monkeypatch):
    told = []
    monkeypatch.setattr(manager, "in_reserve", lambda: told.append(True) or waiting.called.set())
    waiting.await_turn(Event())
    waiting.await_turn(Event())
    assert told == [True]


@pytest.mark.usefixtures("_in_reserve")
def test_a_process_in_reserve_that_is_stopped_does_not_join_the_bus():
    stop = Event()
    stop.set()
    with pytest.raises(NotNeededError):
        waiting.await_turn(stop)


def test_a_driver_has_no_reserve():
    with pytest.raises(ValidationError, match="not for verb driver"):
        FacilityService(verb="driver", driver="ifm", reserve=True)
