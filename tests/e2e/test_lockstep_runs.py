"""Runs at ``--speed max``: every frame counts, a seed tells all bytes, and facilities never meet.

Two facilities with a camera and a LIDAR run on this machine at the same time, each beside the load of the
other. They have the same seed, with two hash seeds of Python. What another seed changes,
``tests/integration/test_lockstep.py`` shows.
"""

import json
from collections import Counter
from contextlib import ExitStack, closing
from pathlib import Path

import pytest
from command_line import called
from due_frames import due_frames
from facility_process import FacilityProcess, Finished
from logs import messages_of, read_closed
from mcap.reader import make_reader

from rpod.scenarios import find
from rpod_analysis.log import open_log
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.replay import ReplayReport
from rpod_schemas.rmw.cdr import decode, encode
from rpod_schemas.summary import Summary
from rpod_schemas.topics import (
    CLOCK,
    DEPTH,
    DIAGNOSTICS,
    ESTIMATE,
    ESTIMATE_POSE,
    INTEGRITY,
    PARAMETER_EVENTS,
    POINTS,
    ROSOUT,
    STATUS,
    TRUTH,
    Topic,
)

BOTH = """
name: both
title: The mock-up by a camera and a LIDAR
target: mockup
duration_s: 2
seed: 1
motion:
  trajectory: {kind: approach, start_m: [0, 0, 4], end_m: [0, 0, 3]}
  attitude: {kind: spin, axis: [1, 0, 0], rate_deg_s: 5}
  sun: {direction: [0.5, -0.6, -0.62]}
sensors: [{kind: pmd, rate_hz: 10}, {kind: lidar, rate_hz: 2}]
estimator: {sensors: [{kind: pmd}, {kind: lidar}]}
"""
DURATION_S = 1.5
SCANS, IMAGES = POINTS.of("lidar"), DEPTH.of("pmd")
OF_PROCESSES = {DIAGNOSTICS.name, ROSOUT.name, PARAMETER_EVENTS.name}
"""Topics whose messages come in the order of the processes' own time."""
RUNS = {
    "seven": ("--seed", "7", "--json"),
    "seven again": ("--seed", "7"),
}


@pytest.fixture(scope="session")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scenario") / "both.yaml"
    path.write_text(BOTH, "utf-8")
    return path


@pytest.fixture(scope="session")
def runs(scenario: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Finished]:
    arguments = (str(scenario), "--speed", "max", "--duration", f"{DURATION_S:g}")
    with ExitStack() as stack, pytest.MonkeyPatch.context() as patch:
        started = {}
        for seed, (name, more) in enumerate(RUNS.items()):
            patch.setenv("PYTHONHASHSEED", str(seed))
            run = FacilityProcess(*arguments, *more, out=tmp_path_factory.mktemp("lockstep"))
            started[name] = stack.enter_context(closing(run))
        return {name: run.finish() for name, run in started.items()}


@pytest.fixture(scope="session")
def due(scenario: Path) -> list[int]:
    """Stamps of the frames that are due, ns, those of equal stamps once for each sensor."""
    read = find(str(scenario))
    frames = due_frames(read.sensors, epoch_ns=read.epoch_ns, duration_s=DURATION_S)
    return [frame.stamp_ns for frame in frames]


def content(run: Finished) -> dict[str, list[bytes]]:
    """Return the messages of each topic in the order of their numbers, without times of processing."""
    found: dict[str, list[tuple[int, bytes]]] = {}
    with run.log.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            data, name = bytes(message.data), channel.topic.lstrip("/")
            if name == STATUS.name:
                status = decode(data, schema.name)
                status.processing_s = 0.0
                data = bytes(encode(status))
            if name not in OF_PROCESSES:
                found.setdefault(name, []).append((message.sequence, data))
    return {name: [data for _, data in sorted(messages)] for name, messages in found.items()}


def payloads(run: Finished, topic: Topic) -> list[bytes]:
    return [message.data for message in messages_of(run.log, f"/{topic.name}")]


@pytest.fixture(params=RUNS)
def run(request, runs) -> Finished:
    return runs[request.param]


def test_every_run_succeeds(run):
    assert run.code == 0, run.stderr
    read_closed(run.log)


def test_there_is_one_status_for_every_frame_that_is_due(run, due):
    with open_log(run.log) as log:
        assert [status.stamp_ns for status in log.statuses()] == due


def test_nothing_is_dropped_or_missed(run):
    assert run.summary.estimates.dropped == 0
    assert run.summary.estimates.unscored == 0
    # Diagnostics follow the wall clock. The log lacks one in a few runs of a hundred (docs/limits.md).
    missed = {name: count.missed for name, count in run.summary.frames.items() if count.missed}
    assert missed.keys() <= {DIAGNOSTICS.name}
    with open_log(run.log) as log:
        counts = {name: count for name, count in log.counts.items() if name != DIAGNOSTICS.name}
        assert all(count.lost == count.missed == count.duplicates == 0 for count in counts.values())


def test_the_summary_has_the_keys_of_handovers_and_of_integrity(runs):
    found = json.loads(runs["seven"].stdout)
    assert {"count", "gap_s", "jump_m", "jump_deg"} <= set(found["handover"])
    assert set(found["integrity"]) == {"misleading", "alerts", "availability"}


def test_the_target_is_tracked(run):
    assert run.summary.modes.tracking_share > 0.9
    assert run.summary.error.attitude_deg.max < 10.0
    assert run.summary.error.position_m.max < 0.5


def test_time_is_the_scenarios(run, scenario):
    with open_log(run.log) as log:
        truth_ns = [odometry.stamp_ns for odometry in log.odometry(TRUTH)]
        (clock,) = {type(logged.decode()).__name__ for logged in log.messages(CLOCK)}
        assert clock.endswith("Clock")
        assert log.topics[CLOCK.name].count > 0
    preroll_ns, tail_ns = NANOSECONDS // 10, NANOSECONDS // 10
    epoch_ns = find(str(scenario)).epoch_ns
    assert truth_ns[0] == epoch_ns - preroll_ns
    assert truth_ns[-1] == epoch_ns + round(DURATION_S * NANOSECONDS) + tail_ns
    assert truth_ns == sorted(set(truth_ns))
    assert run.summary.latency_s is None


def test_runs_of_one_seed_are_equal_to_the_last_message(runs, due):
    first, again = content(runs["seven"]), content(runs["seven again"])
    assert len(first[SCANS.name]) + len(first[IMAGES.name]) == len(first[STATUS.name]) == len(due)
    assert all(first[topic.name] for topic in (TRUTH, CLOCK, ESTIMATE, ESTIMATE_POSE))
    assert [name for name in first.keys() | again.keys() if first.get(name) != again.get(name)] == []


def test_the_seed_of_the_command_line_is_that_of_the_run(runs):
    for run in runs.values():
        assert run.summary.seed == 7
        with open_log(run.log) as log:
            assert log.configuration["emulator"]["seed"] == 7


def test_facilities_at_the_same_time_have_nothing_in_common(runs):
    endpoints, identities = set(), set()
    for run in runs.values():
        with open_log(run.log) as log:
            endpoints |= {service["bus"]["connect"] for service in log.configuration.values()}
            identities.add(log.configuration["estimator"]["zenoh_id"])
            numbers = Counter(
                (value.name, logged.sequence)
                for logged in log.messages(DIAGNOSTICS)
                for value in logged.decode().status
            )
        assert {name for name, _ in numbers} == {"motion", "emulator", "estimator", "logger", "supervisor"}
        assert set(numbers.values()) == {1}, "one publisher of each name"
    assert len(endpoints) == len(identities) == len(runs)


def test_output_that_is_no_terminal_tells_the_progress_and_ends_with_log_and_report(runs):
    run = runs["seven again"]
    lines = run.stderr.splitlines()
    assert any(line.startswith("waiting for") for line in lines)
    assert any(f"/ {DURATION_S:g} s" in line for line in lines)
    assert "stopping motion" in run.stderr
    assert "\x1b" not in run.stdout + run.stderr, "no codes for a terminal"
    *table, log, report = run.stdout.splitlines()
    assert log.split() == ["log", str(run.log)]
    assert report.split() == ["report", str(run.directory / "report.html")]
    assert "attitude" in "".join(table)


def test_json_prints_nothing_else(runs):
    run = runs["seven"]
    assert Summary.model_validate_json(run.stdout) == run.summary
    assert not run.stderr


@pytest.mark.parametrize("how", [(), ("--as-live",)], ids=["all frames", "as live"])
def test_a_replay_makes_the_very_estimates_of_the_run(runs, due, how, tmp_path):
    log, out = runs["seven"].log, tmp_path / "again.mcap"
    done = called("replay", log, *how, "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    report = ReplayReport.model_validate_json(done.stdout)
    assert (report.frames, report.missing, report.refused) == (len(due), 0, {})
    assert report.difference.identical == report.difference.common > 0
    assert report.new.estimates == report.old.estimates
    assert report.new.error == report.old.error
    with open_log(out) as new:
        for topic in (ESTIMATE, ESTIMATE_POSE, INTEGRITY):
            assert [m.payload for m in new.messages(topic.under("replay"))] == payloads(runs["seven"], topic)
