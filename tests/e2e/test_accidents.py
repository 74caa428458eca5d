"""Runs that do not end as planned: whatever happens, the log is whole and no process stays behind."""

import signal

import pytest
from logger_desk import completeness
from logs import messages_of, read_closed

from rpod_schemas.topics import TRUTH

TRUTH_CHANNEL = f"/{TRUTH.name}"
PLAY = ("envisat-station", "--duration", "600")


def test_an_interrupted_run_closes_its_log_and_says_where_it_is(start):
    run = start(*PLAY)
    run.await_playing()
    run.send(signal.SIGINT)
    assert run.wait() == 130
    assert not run.left()
    assert "interrupted" in run.stderr.text()
    assert str(run.log) in run.stderr.text()
    assert read_closed(run.log)[TRUTH_CHANNEL] > 0
    assert completeness(run.log).reasons == (), "an interruption is an end in order"
    assert (run.directory / "scenario.json").exists()


@pytest.mark.parametrize(
    ("number", "waiting", "logging"),
    [
        (signal.SIGINT, "emulator, estimator, logger, motion", False),
        (signal.SIGTERM, "(?!.*logger)", True),
    ],
    ids=["interrupted while all start", "terminated when the logger is there"],
)
def test_a_run_that_still_starts_leaves_nothing_behind(start, number, waiting, logging):
    run = start(*PLAY)
    run.await_services()
    run.stderr.wait_for(f"waiting for {waiting}")
    run.send(number)
    assert run.wait() == 130
    assert not run.left()
    said = run.stderr.text()
    assert "interrupted" in said
    assert "Traceback" not in said
    assert "ERROR" not in said
    assert run.log.exists() or not logging
    if run.log.exists():
        read_closed(run.log)
        assert str(run.log) in said


def test_a_second_interrupt_ends_the_run_at_once_and_the_services_follow(start):
    run = start(*PLAY)
    run.await_playing()
    emulator = run.services["emulator"]
    emulator.suspend()  # so that the orderly way would take long
    run.send(signal.SIGINT)
    run.stderr.wait_for("stopping emulator")
    run.send(signal.SIGINT)
    assert run.wait() == 130
    assert "it was killed" not in run.stderr.text()
    emulator.resume()
    assert not run.left()
    assert read_closed(run.log)[TRUTH_CHANNEL] > 0


@pytest.mark.parametrize(
    ("verb", "speed", "reason"),
    [
        ("emulator", "1", "emulator (session "),
        ("motion", "max", "motion (session "),
        ("router", "1", "the bus was lost: since "),
    ],
)
def test_a_run_whose_service_is_killed_names_it_as_its_log_does(start, verb, speed, reason):
    run = start(*PLAY, "--speed", speed)
    run.await_playing()
    run.services[verb].kill()
    assert run.wait() == 1
    assert not run.left()
    said = run.stderr.text()
    assert f"service {verb} was killed by signal 9" in said
    assert f"{verb}: ready: " in said, "its last lines"
    assert str(run.log) in said
    assert "Traceback" not in said
    assert read_closed(run.log)[TRUTH_CHANNEL] > 0
    assert [each for each in completeness(run.log).reasons if each.startswith(reason)]


def test_the_log_of_a_killed_logger_holds_what_was_synced(start):
    run = start(*PLAY)
    run.await_playing()
    synced = len(messages_of(run.log, TRUTH_CHANNEL))
    run.services["logger"].kill()
    assert run.wait() == 1
    assert not run.left()
    assert "service logger was killed by signal 9" in run.stderr.text()
    sequences = [message.sequence for message in messages_of(run.log, TRUTH_CHANNEL)]
    assert len(sequences) >= synced > 0
    assert sequences == list(range(1, len(sequences) + 1))


def test_a_router_that_dies_while_all_start_is_named(start):
    run = start(*PLAY)
    run.await_services()
    run.services["router"].kill()
    assert run.wait() == 1
    assert not run.left()
    assert "service router was killed by signal 9" in run.stderr.text()


def test_the_services_of_a_killed_supervisor_end_and_close_the_log(start):
    run = start(*PLAY)
    run.await_playing()
    run.send(signal.SIGKILL)
    assert run.wait() == -signal.SIGKILL
    assert not run.left()
    assert read_closed(run.log)[TRUTH_CHANNEL] > 0
    reasons = completeness(run.log).reasons
    assert [each for each in reasons if each.startswith("the run was ended by a kill: its supervisor")]
