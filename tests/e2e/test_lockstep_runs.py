"""Runs at ``--speed max``: every frame counts, a seed tells all bytes, and facilities never meet.

Three facilities run on this machine at the same time, two of them with the same seed.
"""

import subprocess
import sys
from contextlib import ExitStack, closing

import pytest
from facility_process import FacilityProcess, Finished
from logs import messages_of, read_closed

from rpod.scenarios import find
from rpod_analysis.log import open_log
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.replay import ReplayReport
from rpod_schemas.schedule import due_frames
from rpod_schemas.summary import Summary
from rpod_schemas.topics import CLOCK, DIAGNOSTICS, ESTIMATE, ESTIMATE_POSE, POINTS, TRUTH, Topic

SCENARIO = find("envisat-station")
DURATION_S = 8.0
SCANS = POINTS.of("lidar")
RUNS = {
    "seven": ("--seed", "7", "--json"),
    "seven again": ("--seed", "7"),
    "eight": ("--seed", "8", "--json"),
}


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Finished]:
    arguments = (SCENARIO.name, "--speed", "max", "--duration", f"{DURATION_S:g}")
    with ExitStack() as stack:
        started = {
            name: stack.enter_context(
                closing(FacilityProcess(*arguments, *more, out=tmp_path_factory.mktemp("lockstep")))
            )
            for name, more in RUNS.items()
        }
        return {name: run.finish() for name, run in started.items()}


def payloads(run: Finished, topic: Topic) -> list[bytes]:
    return [message.data for message in messages_of(run.log, f"/{topic.name}")]


@pytest.fixture(params=RUNS)
def run(request, runs) -> Finished:
    return runs[request.param]


def test_every_run_succeeds(run):
    assert run.code == 0, run.stderr
    read_closed(run.log)


def test_there_is_one_status_for_every_frame_that_is_due(run):
    due = due_frames(SCENARIO.sensors, epoch_ns=SCENARIO.epoch_ns, duration_s=DURATION_S)
    with open_log(run.log) as log:
        stamps = [status.stamp_ns for status in log.statuses()]
    assert stamps == [frame.stamp_ns for frame in due]
    assert len(stamps) == DURATION_S


def test_nothing_is_dropped_or_missed(run):
    assert run.summary.estimates.dropped == 0
    assert run.summary.estimates.unscored == 0
    assert {name: count.missed for name, count in run.summary.frames.items() if count.missed} == {}
    with open_log(run.log) as log:
        assert all(count.lost == count.missed == count.duplicates == 0 for count in log.counts.values())


def test_the_target_is_tracked(run):
    assert run.summary.modes.tracking_share == 1.0
    assert run.summary.error.attitude_deg.max < 10.0
    assert run.summary.error.position_m.max < 0.5


def test_time_is_the_scenarios(run):
    with open_log(run.log) as log:
        truth_ns = [odometry.stamp_ns for odometry in log.odometry(TRUTH)]
        (clock,) = {type(logged.decode()).__name__ for logged in log.messages(CLOCK)}
        assert clock.endswith("Clock")
        assert log.topics[CLOCK.name].count >= DURATION_S
    preroll_ns, tail_ns = NANOSECONDS // 10, NANOSECONDS // 10
    assert truth_ns[0] == SCENARIO.epoch_ns - preroll_ns
    assert truth_ns[-1] == SCENARIO.epoch_ns + round(DURATION_S * NANOSECONDS) + tail_ns
    assert truth_ns == sorted(set(truth_ns))
    assert run.summary.latency_s is None


def test_a_seed_tells_every_byte_of_scans_and_estimates(runs):
    for topic in (SCANS, ESTIMATE, ESTIMATE_POSE, TRUTH):
        first, again = (payloads(runs[name], topic) for name in ("seven", "seven again"))
        assert first
        assert first == again, topic


def test_another_seed_gives_other_scans_and_estimates_of_the_same_truth(runs):
    for topic in (SCANS, ESTIMATE):
        seven, eight = (set(payloads(runs[name], topic)) for name in ("seven", "eight"))
        assert not seven & eight, topic
    assert payloads(runs["seven"], TRUTH) == payloads(runs["eight"], TRUTH)
    assert [runs[name].summary.seed for name in RUNS] == [7, 7, 8]


def test_facilities_at_the_same_time_have_nothing_in_common(runs):
    endpoints, identities = set(), set()
    for run in runs.values():
        with open_log(run.log) as log:
            endpoints |= {service["bus"]["connect"] for service in log.configuration.values()}
            identities.add(log.configuration["estimator"]["zenoh_id"])
            names = [value.name for logged in log.messages(DIAGNOSTICS) for value in logged.decode().status]
            first = [logged for logged in log.messages(DIAGNOSTICS) if logged.sequence == 1]
        assert len(first) == len(set(names)), "one publisher of each name"
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
    run = runs["eight"]
    assert Summary.model_validate_json(run.stdout) == run.summary
    assert not run.stderr


@pytest.mark.parametrize("how", [(), ("--as-live",)], ids=["all frames", "as live"])
def test_a_replay_makes_the_very_estimates_of_the_run(runs, how, tmp_path):
    log, out = runs["seven"].log, tmp_path / "again.mcap"
    done = subprocess.run(
        [sys.executable, "-m", "rpod", "replay", str(log), *how, "--out", str(out), "--json"],
        capture_output=True,
        text=True,
        timeout=120.0,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    report = ReplayReport.model_validate_json(done.stdout)
    assert (report.frames, report.missing, report.refused) == (DURATION_S, 0, {})
    assert report.difference.identical == report.difference.common == report.old.estimates > 0
    assert report.new.error == report.old.error
    with open_log(out) as new:
        for topic in (ESTIMATE, ESTIMATE_POSE):
            assert [m.payload for m in new.messages(topic.under("replay"))] == payloads(runs["seven"], topic)
