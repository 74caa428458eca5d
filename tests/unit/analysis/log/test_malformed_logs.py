"""Malformed messages end no verb: they are left out, counted, and told."""

import json

import pytest
import rerun as rr
from malformed_logs import FAULTS, INFO, TOPICS, write_good, write_malformed
from synthetic_log import T_CHASER_SENSOR, SyntheticRun, approach

from rpod_analysis.calibration.depth_samples import collect
from rpod_analysis.errors import CalibrationError
from rpod_analysis.log import open_log
from rpod_analysis.log.stamp_check import StampCheck
from rpod_analysis.recovery import recover
from rpod_analysis.replay import compare, replay
from rpod_analysis.replay.frames import Frames
from rpod_analysis.replay.log_view import show_log
from rpod_analysis.report import write_report
from rpod_analysis.report.content import gather_content
from rpod_analysis.scoring.run import stream_run
from rpod_estimator.frame_reader import FrameReader
from rpod_schemas.config.estimator import EstimatorConfig, PmdInput
from rpod_view.view import View

UNSTAMPED = ("tf_static", "tf")
"""Their stamps are no times of the run."""
REPLAYED = ("tf_static", "pmd/info", "pmd/camera_info", "pmd/depth/image_raw", "pmd/amplitude/image_raw")
CONFIG = EstimatorConfig(target="mockup", sensors=(PmdInput(),), initial_pose=T_CHASER_SENSOR * approach(0.0))


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    run = SyntheticRun(duration_s=0.5, rate_hz=10.0, clock=True, info=INFO, target="mockup")
    return write_good(folder / "good.mcap", run)


@pytest.fixture(scope="module")
def malformed(good, tmp_path_factory):
    folder = tmp_path_factory.mktemp("malformed")
    names = {topic: folder / f"{topic.replace('/', '_')}.mcap" for topic in TOPICS}
    return {topic: write_malformed(good, path, topic) for topic, path in names.items()}


def told_of(path):
    with open_log(path) as log:
        return gather_content(log, stream_run(log), name="")


@pytest.fixture(scope="module")
def clean(good):
    return told_of(good)


@pytest.mark.parametrize("topic", TOPICS)
def test_a_report_counts_malformed_messages_and_scores_the_others(malformed, clean, topic):
    content = told_of(malformed[topic])
    for key in ("duration_s", "estimates", "modes", "error", "latency_s", "consistency"):
        assert getattr(content.summary, key) == getattr(clean.summary, key), key
    ahead = {} if topic in UNSTAMPED else {"future": 1}
    assert content.summary.unreadable == {topic: {"malformed": len(FAULTS) - 1, **ahead}}
    assert [check.good for check in content.checks if check.question == "Messages"] == [False]


def test_a_report_shows_malformed_messages(malformed, good, tmp_path):
    paths = write_report([malformed["truth/odometry"]], tmp_path)
    assert "<td>truth/odometry</td><td>malformed</td>" in paths.html.read_text("utf-8")
    unreadable = json.loads(paths.summary.read_text("utf-8"))["unreadable"]
    assert unreadable == {"truth/odometry": {"malformed": 3, "future": 1}}
    paths = write_report([good], tmp_path)
    assert "Messages that cannot be read" not in paths.html.read_text("utf-8")
    assert json.loads(paths.summary.read_text("utf-8"))["unreadable"] == {}


def test_iterators_leave_a_malformed_message_out(malformed):
    for path in malformed.values():
        with open_log(path) as log:
            assert len(list(log.odometry())) in (6, 7)
            assert len(list(log.statuses())) in (6, 7)
            assert log.extrinsics


def taken(path):
    """Return the stamps of the frames that a replay takes, and what it refuses."""
    with open_log(path) as log:
        frames = Frames(FrameReader(CONFIG.sensors), StampCheck(log))
        events = [event for logged in log.messages() for event in frames.take(logged)] + frames.rest()
    return [event.stamp_ns for event in events if event.measurement is not None], dict(frames.refused)


def test_a_replay_takes_all_other_frames(good, malformed):
    stamps, refused = taken(good)
    assert len(stamps) == 6
    assert refused == {}
    refused_topics = set()
    for topic, path in malformed.items():
        found, refused = taken(path)
        assert found == stamps, topic
        # What comes behind its own frame is not looked at, nor when a latched message was made.
        assert refused in ({}, {topic: len(FAULTS) - 1}, {topic: len(FAULTS)})
        refused_topics |= set(refused)
    assert refused_topics == set(REPLAYED)


@pytest.mark.parametrize("topic", ["clock", "truth/odometry", "estimate/status"])
def test_a_replay_ends_as_without_the_malformed_messages(good, malformed, tmp_path, topic):
    def outcome(path):
        with open_log(path) as log:
            replayed = replay(log, CONFIG, out=tmp_path / "out.mcap", start_s=0.1, end_s=0.3)
            compare(log, replayed)
            return replayed.frames

    assert outcome(malformed[topic]) == outcome(good)


def test_a_view_draws_the_others(malformed):
    for path in malformed.values():
        refused: list[object] = []
        view = View(
            rr.RecordingStream("rpod"),
            target=None,
            prefix="estimate",
            reject=lambda *told, refused=refused: refused.append(told),
        )
        with open_log(path) as log:
            show_log(log, view, prefix="estimate", rate_hz=10.0)
            assert len(refused) + sum(each.count for each in log.unreadable.kinds) <= 2 * len(FAULTS)


def test_a_recovery_keeps_malformed_messages_as_they_are(malformed, good, tmp_path):
    with open_log(good) as log:
        messages = sum(info.count for info in log.topics.values())
    for number, path in enumerate(malformed.values()):
        assert recover(path, tmp_path / f"{number}.mcap").messages == messages + len(FAULTS)


def test_a_calibration_uses_the_others(malformed):
    for path in malformed.values():
        with open_log(path) as log, pytest.raises(CalibrationError, match="shows a face"):
            collect([log], "pmd")  # the images are all of one depth: it gets as far as looking at them
