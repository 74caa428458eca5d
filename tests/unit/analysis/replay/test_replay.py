"""A log through the navigator again: the same bytes, the frames of the live run, another configuration."""

import json
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from synthetic_log import EPOCH_NS, T_CHASER_SENSOR, Frame, SyntheticRun, approach, see_depth

from rpod.logs.replay import navigator_command
from rpod_analysis import AnalysisError, open_log
from rpod_analysis.replay import compare, configured_estimator, replay
from rpod_pose.navigation.integrity.wrong_streams import CLOCK_MOVED_S
from rpod_pose.navigation.sensors.newcomers import TOO_OLD
from rpod_runtime.process.lifecycle import EXIT_FAILURE, EXIT_USAGE
from rpod_schemas.config.estimator import EstimatorConfig, PmdInput
from rpod_schemas.logs import CONFIGURATION, REPLAY
from rpod_schemas.messages import read_integrity
from rpod_schemas.rmw.cdr import decode, typestore
from rpod_schemas.topics import ESTIMATE, INTEGRITY, STATUS
from rpod_schemas.types import Camera, IntegrityState, Mode
from rpod_target import load_target

CAMERA = Camera(width=88, height=72, fx=170.0, fy=170.0, cx=43.5, cy=35.5)
CONFIG = EstimatorConfig(target="mockup", sensors=(PmdInput(),), initial_pose=T_CHASER_SENSOR * approach(0.0))
NEW_STATUS, NEW_ESTIMATE = STATUS.under(REPLAY), ESTIMATE.under(REPLAY)


@pytest.fixture(scope="module")
def run():
    return SyntheticRun(
        duration_s=1.0, camera=CAMERA, target="mockup", render=see_depth(load_target("mockup"), CAMERA)
    )


@pytest.fixture(scope="module")
def log_path(run, tmp_path_factory):
    return run.write(tmp_path_factory.mktemp("replay") / "run.mcap")


@pytest.fixture(scope="module")
def replayed(log_path):
    with open_log(log_path) as log:
        return replay(log, CONFIG)


def test_two_replays_are_the_same_file_byte_for_byte(log_path, replayed, tmp_path):
    with open_log(log_path) as log:
        again = replay(log, CONFIG, out=tmp_path / "again.mcap")
    assert again.out.read_bytes() == replayed.out.read_bytes()


def test_the_new_log_holds_the_truth_and_both_estimates(log_path, replayed):
    assert replayed.out == log_path.with_name("run.replay.mcap")
    with open_log(log_path) as log, open_log(replayed.out) as new:
        for topic in ("truth/odometry", "estimate/odometry", "estimate/status", "tf_static"):
            assert [m.payload for m in new.messages(topic)] == [m.payload for m in log.messages(topic)]
        assert "pmd/depth/image_raw" not in new.topics
        assert new.topics[NEW_STATUS.name].count == 11
        assert new.configuration[REPLAY]["prefix"] == REPLAY
        stamps = [status.stamp_ns for status in new.statuses(NEW_STATUS)]
        assert stamps == [EPOCH_NS + k * 100_000_000 for k in range(11)]


def test_the_target_is_found_where_it_was(log_path, replayed):
    with open_log(log_path) as log:
        compared = compare(log, replayed)
    assert compared.old.error.position_m.max < 1e-9, "made without error"
    assert compared.new.modes.tracking_share == 1.0
    assert compared.new.error.position_m.rms < 0.02
    assert compared.new.error.attitude_deg.rms < 2.0
    assert compared.difference.common == compared.new.estimates > 8
    assert compared.difference.identical == 0
    assert compared.difference.position_m.max == pytest.approx(compared.new.error.position_m.max, rel=1e-6)


def integrity_of(path):
    with open_log(path) as new:
        logged = new.messages(INTEGRITY.under(REPLAY))
        return [read_integrity(message.decode()) for message in logged]


def test_each_status_of_a_replay_has_its_integrity(log_path, replayed):
    told = integrity_of(replayed.out)
    assert [each.stamp_ns for each in told] == [EPOCH_NS + k * 100_000_000 for k in range(11)]
    assert all(0.0 < each.position_level_m < 1.0 for each in told[2:])
    with open_log(log_path) as log:
        compared = compare(log, replayed)
    assert compared.old.integrity is None, "the live estimator told none"
    assert compared.new.integrity.misleading == 0


def test_a_frozen_stream_is_an_alert_in_a_replay(run, tmp_path):
    """The image is the same from the seventh frame on."""
    frozen = replace(
        run, render=lambda _pose, number: run.render(approach(0.1 * min(number, 6)), min(number, 6))
    )
    with open_log(frozen.write(tmp_path / "run.mcap")) as log:
        done = replay(log, CONFIG)
    told = integrity_of(done.out)
    assert told[-1].state == IntegrityState.ALERT
    assert "pmd" in told[-1].reason
    assert told[5].state != IntegrityState.ALERT


def test_as_live_takes_the_frames_that_the_live_run_took(run, tmp_path):
    """The live run of this log passed over every third frame, and refused one as late.

    Another one was older than the filter's history. The replay gives it to the navigator, which decides.
    """

    def frame(number, _time_s):
        moved = {CLOCK_MOVED_S: -0.05} if number == 9 else {}
        return Frame(reason={4: "late: 1.2 s old, limit 1 s", 6: TOO_OLD}.get(number, ""), evidence=moved)

    path = replace(run, frame=frame, skipped=lambda number: number % 3 == 2).write(tmp_path / "run.mcap")
    with open_log(path) as log:
        done = replay(log, CONFIG, as_live=True)
        named = [status.stamp_ns for status in log.statuses()]
    with open_log(done.out) as new:
        statuses = list(new.statuses(NEW_STATUS))
    assert [status.stamp_ns for status in statuses] == named
    assert len(named) == 8
    assert [status.reason for status in statuses if not status.accepted] == ["late: 1.2 s old, limit 1 s"]
    assert (done.frames, done.missing) == (8, 0)
    told = integrity_of(done.out)  # of a clock that had moved the live run knew by arrivals
    assert [each.state == IntegrityState.ALERT for each in told] == [False] * 6 + [True] * 2
    assert "the stamps of pmd have moved by -0.050 s" in told[-1].reason


def test_frames_that_the_log_lost_are_counted(run, tmp_path):
    path = replace(run, unlogged=2, duration_s=0.6).write(tmp_path / "run.mcap")
    with open_log(path) as log:
        done = replay(log, CONFIG, as_live=True)
    assert (done.frames, done.missing) == (5, 2)


def test_a_part_of_a_log_is_replayed_with_what_was_latched_before_it(log_path, tmp_path):
    with open_log(log_path) as log:
        done = replay(
            log,
            CONFIG.model_copy(update={"initial_pose": T_CHASER_SENSOR * approach(0.55)}),
            out=tmp_path / "part.mcap",
            start_s=0.55,
            end_s=0.95,
        )
    with open_log(done.out) as new:
        assert [round((s.stamp_ns - EPOCH_NS) * 1e-9, 1) for s in new.statuses(NEW_STATUS)] == [
            0.6,
            0.7,
            0.8,
            0.9,
        ]
        assert all(status.accepted for status in new.statuses(NEW_STATUS))


def test_silence_loses_the_target_as_it_does_live(run, tmp_path):
    gap = replace(run, duration_s=4.0, rate_hz=1 / 3.5, with_estimates=False).write(tmp_path / "run.mcap")
    with open_log(gap) as log:
        settings = CONFIG.model_copy(
            update={"navigator": CONFIG.navigator.model_copy(update={"confirmations": 0})}
        )
        done = replay(log, settings)
    with open_log(done.out) as new:
        lost = [status for status in new.statuses(NEW_STATUS) if not status.sensor]
    (status,) = lost
    assert status.mode == Mode.LOST
    assert status.reason.startswith("no measurement was accepted for 2.60 s, sigma of the ")


def test_a_track_coasts_over_frames_without_content_as_it_does_live(run, tmp_path):
    def blind_from_the_seventh_frame_on(T_sensor_target, number):
        depth_m, amplitude = run.render(T_sensor_target, number)
        return (depth_m if number < 6 else np.full_like(depth_m, np.nan)), amplitude

    blind = replace(run, render=blind_from_the_seventh_frame_on, duration_s=1.6, with_estimates=False)
    with open_log(blind.write(tmp_path / "run.mcap")) as log:
        done = replay(log, CONFIG)
    with open_log(done.out) as new:
        modes = [status.mode for status in new.statuses(NEW_STATUS)]
    assert set(modes[:6]) == {Mode.TRACKING}
    assert Mode.COASTING in modes[6:]


def with_configuration(source, out, **services):
    """Copy a log with other configurations in it."""
    with source.open("rb") as stream, out.open("wb") as target:
        reader, writer = make_reader(stream), Writer(target)
        writer.start(profile="ros2")
        channels = {}
        for schema, channel, message in reader.iter_messages():
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, "cdr", number)
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            )
        writer.add_metadata(CONFIGURATION, {name: json.dumps(model) for name, model in services.items()})
        writer.finish()
    return out


def test_the_configuration_is_the_logs_own_unless_another_is_given(log_path, tmp_path):
    other = CONFIG.model_copy(update={"instance": "second", "prefix": "b"})
    models = {model.instance: model.model_dump(mode="json") for model in (other, CONFIG)}
    path = with_configuration(log_path, tmp_path / "run.mcap", **models, emulator={"seed": 3})
    with open_log(path) as log:
        found = configured_estimator(log)
        assert found.model_dump(exclude={"initial_pose"}) == CONFIG.model_dump(exclude={"initial_pose"})
    path = with_configuration(log_path, tmp_path / "none.mcap", emulator={"seed": 3})
    with open_log(path) as log, pytest.raises(AnalysisError, match="give one with --config"):
        configured_estimator(log)


def test_a_log_is_never_written_over_itself(log_path):
    before = log_path.read_bytes()
    with open_log(log_path) as log, pytest.raises(AnalysisError, match="is the log itself"):
        replay(log, CONFIG, out=log_path)
    assert log_path.read_bytes() == before


def test_a_log_without_frames_of_the_sensors_is_refused_with_the_topics_that_it_has(log_path, tmp_path):
    other = CONFIG.model_copy(update={"sensors": (PmdInput(name="front"),)})
    reason = "no message of front/depth/image_raw, .* it holds .*pmd/depth/image_raw.*; name the topics"
    with open_log(log_path) as log, pytest.raises(AnalysisError, match=reason):
        replay(log, other, out=tmp_path / "new.mcap")
    assert not list(tmp_path.iterdir())


def test_a_replay_without_any_frame_fails(log_path, tmp_path, capsys):
    given = {"config": None, "as_live": False, "out": tmp_path / "new.mcap", "as_json": True}
    path = with_configuration(log_path, tmp_path / "run.mcap", estimator=CONFIG.model_dump(mode="json"))
    assert navigator_command([path], start_s=0.0, end_s=0.001, **given) == EXIT_FAILURE
    assert "no frame was replayed: none of its frames is complete" in capsys.readouterr().err


@pytest.mark.parametrize("time_s", [float("nan"), float("inf"), -5.0])
def test_a_time_that_no_log_has_is_refused(log_path, time_s, tmp_path, capsys):
    given = {"config": None, "as_live": False, "out": tmp_path / "new.mcap", "as_json": True}
    assert navigator_command([log_path], start_s=time_s, end_s=None, **given) == EXIT_USAGE
    assert f"--from: is {time_s:g}; give seconds" in capsys.readouterr().err


def test_a_target_that_fails_leaves_no_file(log_path, tmp_path):
    with open_log(log_path) as log, pytest.raises(AnalysisError, match="no such file"):
        replay(log, CONFIG, out=tmp_path / "nowhere" / "out.mcap")
    assert not list(tmp_path.iterdir())


def test_the_new_estimates_say_nothing_of_when_they_were_made(replayed):
    with open_log(replayed.out) as new:
        assert all(np.isnan(status.processing_s) for status in new.statuses(NEW_STATUS))
        first = next(new.messages(NEW_ESTIMATE))
        assert decode(first.payload, first.type).child_frame_id == "target_estimate"
        assert first.log_ns == first.publish_ns


def test_other_readers_open_the_new_log(replayed):
    with AnyReader([replayed.out], default_typestore=typestore()) as reader:
        types = {reader.deserialize(raw, item.msgtype).__msgtype__ for item, _, raw in reader.messages()}
    assert STATUS.type in types
    with open_log(replayed.out) as new:
        count = sum(info.count for info in new.topics.values())
    with replayed.out.open("rb") as stream:
        decoded = list(make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages())
    assert len(decoded) == count
