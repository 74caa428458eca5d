"""A short run by the wall clock, ``rpod run mockup-tumbling --json``: what it says and leaves."""

import json
from collections import Counter
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from facility_process import FacilityProcess, Finished
from logs import read_closed
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from rpod_analysis.log import open_log
from rpod_schemas.messages import read_diagnostics, read_status
from rpod_schemas.rmw.cdr import peek_stamp, typestore
from rpod_schemas.summary import Summary
from rpod_schemas.topics import (
    DEPTH,
    DIAGNOSTICS,
    ESTIMATE,
    PMD_INFO,
    STATUS,
    SUN,
    TF_STATIC,
    TRUTH,
    TRUTH_TOPICS,
)

DECODED = tuple(topic.name for topic in (DEPTH.of("pmd"), ESTIMATE, STATUS, TRUTH))
LATCHED = tuple(topic.name for topic in (TF_STATIC, PMD_INFO.of("pmd"), SUN))
SIZE = ("rms", "p95", "max")
DURATIONS = ("p50", "p99", "max")
FIELDS = {
    "": ("scenario", "seed", "duration_s", "log", "report", "frames", "estimates", "error", "latency_s",
         "processing_s", "consistency"),
    "estimates": ("count", "accepted", "rejected", "dropped", "unscored", "lost_s"),
    "error": ("attitude_deg", "position_m", "roll_deg_rms", "pitch_deg_rms", "yaw_deg_rms", "x_m_rms",
              "y_m_rms", "z_m_rms"),
    "error.attitude_deg": SIZE,
    "error.position_m": SIZE,
    "latency_s": DURATIONS,
    "processing_s": DURATIONS,
    "consistency": ("nees_mean", "nees_share_in_95"),
    "integrity": ("misleading", "alerts", "availability"),
}  # fmt: skip
"""``summary.json`` as the interface control document has it in section 6."""

_DURATIONS_S = (6, 15, 60)
"""None is the scenario's own."""


@pytest.fixture(scope="session")
def live(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """A run with an accepted pose: on a loaded machine the first search lasts longer than a short run."""
    for duration_s in _DURATIONS_S:
        arguments = ("mockup-tumbling", "--duration", str(duration_s), "--json")
        with closing(FacilityProcess(*arguments, out=tmp_path_factory.mktemp("live"))) as run:
            finished = run.finish()
        if finished.code or finished.summary.estimates.accepted:
            break
    return finished


def asked_s(run: Finished) -> float:
    """Return the duration that was asked for, s."""
    return float(json.loads((run.directory / "scenario.json").read_text("utf-8"))["duration_s"])


def said_last(run: Finished, service: str) -> dict[str, str]:
    """Return the counters that a service told last."""
    with open_log(run.log) as log:
        told = [item for logged in log.messages(DIAGNOSTICS) for item in read_diagnostics(logged.decode())]
    return [item.values for item in told if item.name == service][-1]


def test_it_succeeds_and_prints_the_summary_as_one_object_and_nothing_else(live):
    assert live.code == 0, live.stderr
    assert not live.stderr
    assert Summary.model_validate_json(live.stdout) == live.summary
    assert live.summary.scenario == "mockup-tumbling"
    assert live.summary.seed == 7
    assert live.summary.duration_s > asked_s(live) - 0.5, "the services end later on a loaded machine"


@pytest.mark.parametrize("block", FIELDS)
def test_the_summary_has_every_field_of_the_interface(live, block):
    found = json.loads(live.stdout)
    for name in filter(None, block.split(".")):
        found = found[name]
    assert set(FIELDS[block]) <= set(found)


def test_the_folder_holds_log_report_and_summary(live):
    assert {file.name for file in live.directory.iterdir() if file.is_file()} == {
        "mockup-tumbling.mcap",
        "report.html",
        "scenario.json",
        "summary.json",
        "truth.parquet",
        "frames.parquet",
        "truth.tum",
        "estimate.tum",
    }
    assert Path(live.summary.log) == live.log
    assert Path(live.summary.report) == live.directory / "report.html"
    assert "mockup-tumbling" in (live.directory / "report.html").read_text("utf-8")
    assert asked_s(live) in _DURATIONS_S


def test_no_message_is_missed_between_publishers_and_log(live):
    frames = live.summary.frames
    assert {name: count.missed for name, count in frames.items() if count.missed} == {}
    assert {f"/{name}": count.logged for name, count in frames.items()} == read_closed(live.log)
    with open_log(live.log) as log:
        assert all(count.lost == count.missed == 0 for count in log.counts.values())


def test_all_of_the_truth_is_logged(live):
    """250 Hz, from a tenth of a second before the epoch to a tenth after the end.

    A motion service that stood still at its start says so, and goes on where it would be by then.
    """
    with open_log(live.log) as log:
        stamps_ns = np.array([peek_stamp(logged.payload) for logged in log.messages(TRUTH)])
    assert np.all(np.abs(np.diff(stamps_ns) - 4_000_000) <= 1), "nothing is missing between two"
    if "the motion goes on" not in (live.directory / "logs" / "motion.log").read_text("utf-8"):
        assert len(stamps_ns) == 250 * asked_s(live) + 25 + 25 + 1


def test_every_frame_of_the_camera_is_estimated_or_accounted_for(live):
    """A frame that came to the estimator has a status or is counted; how many come depends on the machine."""
    with open_log(live.log) as log:
        frames = {peek_stamp(logged.payload) for logged in log.messages(DEPTH.of("pmd"))}
        told = {read_status(logged.decode()).stamp_ns for logged in log.messages(STATUS)} & frames
    said = said_last(live, "estimator")
    counted = sum(int(said.get(f"{kind}/pmd", 0)) for kind in ("dropped", "incomplete"))
    assert 0 < int(said[f"received/{DEPTH.of('pmd').name}"]) <= len(told) + counted
    assert len(told) <= len(frames) == live.summary.frames[DEPTH.of("pmd").name].logged
    estimates = live.summary.estimates
    assert live.summary.frames[STATUS.name].logged == estimates.accepted + estimates.rejected


def test_what_is_accepted_is_right(live):
    """How soon, and how often, depends on the machine; runs in lockstep test that."""
    assert live.summary.estimates.accepted > 0
    assert live.summary.estimates.unscored == 0
    assert live.summary.error.attitude_deg.rms < 5.0
    assert live.summary.error.position_m.rms < 0.3
    assert 0.0 < live.summary.processing_s.p50 < live.summary.latency_s.p50


def test_rosbags_decodes_the_log(live):
    decoded: Counter[str] = Counter()
    with AnyReader([live.log]) as bag:
        for connection, _, payload in bag.messages():
            message = typestore().deserialize_cdr(payload, connection.msgtype)
            assert message.__msgtype__ == connection.msgtype
            decoded[connection.topic.removeprefix("/")] += 1
    assert decoded == {name: count.logged for name, count in live.summary.frames.items()}


def test_mcap_ros2_decodes_the_log(live):
    decoded: Counter[str] = Counter()
    with live.log.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages([f"/{name}" for name in DECODED]):
            assert message.header.stamp.sec > 0
            decoded[channel.topic.removeprefix("/")] += 1
    assert decoded == {name: live.summary.frames[name].logged for name in DECODED}


def test_latched_messages_precede_frames_and_estimates_in_the_log(live):
    # Not the truth: on a busy machine its first message may come before the info of a sensor.
    following = {name for name in DECODED if name != TRUTH.name}
    with live.log.open("rb") as stream:
        found = make_reader(stream).iter_messages(log_time_order=False)
        order = list(dict.fromkeys(channel.topic.removeprefix("/") for _, channel, _ in found))
    assert max(order.index(name) for name in LATCHED) < min(order.index(name) for name in following)


def test_the_log_knows_the_configuration_and_version_of_every_service(live):
    with open_log(live.log) as log:
        assert set(log.configuration) == {"motion", "emulator", "estimator", "logger", "supervisor"}
        assert log.configuration["emulator"]["seed"] == 7
        software = log.metadata("software")
    assert software["version"]
    assert software["target_digest"]


def test_the_router_keeps_the_truth_from_the_estimator(live):
    router = json.loads((live.directory / "config" / "router.json").read_text("utf-8"))
    with open_log(live.log) as log:
        assert router["estimators"] == [log.configuration["estimator"]["zenoh_id"]]
    counters = said_last(live, "estimator")
    assert int(counters[f"received/{DEPTH.of('pmd').name}"]) > 0
    assert not {f"received/{topic.name}" for topic in TRUTH_TOPICS} & set(counters)
