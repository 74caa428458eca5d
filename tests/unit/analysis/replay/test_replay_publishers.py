"""A replay uses the holder's messages of each topic, as the live run, and repeats the resets of its log."""

import json
import struct
from dataclasses import dataclass

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from synthetic_log import EPOCH_NS, T_CHASER_SENSOR, Frame, SyntheticRun, approach, see_depth

from rpod_analysis import open_log
from rpod_analysis.replay import replay
from rpod_estimator.estimator import Estimator
from rpod_schemas.config.estimator import EstimatorConfig, PmdInput
from rpod_schemas.control import ResetRequest
from rpod_schemas.logs import GID_METADATA, PUBLISHERS, REPLAY, SESSION_METADATA
from rpod_schemas.messages import write_diagnostics, write_transforms
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw.cdr import definition, encode
from rpod_schemas.topics import CHASER, DIAGNOSTICS, STATUS, TF_STATIC, optical_frame
from rpod_schemas.types import Camera, Diagnostic, Health, Mode
from rpod_target import load_target

CAMERA = Camera(width=88, height=72, fx=170.0, fy=170.0, cx=43.5, cy=35.5)
CONFIG = EstimatorConfig(target="mockup", sensors=(PmdInput(),), initial_pose=T_CHASER_SENSOR * approach(0.0))
DRIVER, INTRUDER = ("a1" * 16, "aaaa"), ("b2" * 16, "bbbb")
LATER_NS = 37_000_000
STATUSES = STATUS.under(REPLAY).name


@dataclass(frozen=True)
class Sent:
    """A message to be written: its channel's topic and type, its publisher, and its record."""

    topic: str
    type: str
    publisher: tuple[str, str] | None
    log_ns: int
    data: bytes


@pytest.fixture(scope="module")
def messages(tmp_path_factory) -> list[Sent]:
    """Messages of a camera, its only publisher, and of an estimator."""

    def mode(_number: int, time_s: float) -> Frame:
        return Frame(mode=Mode.VERIFYING if 0.55 < time_s < 0.65 else Mode.TRACKING)

    render = see_depth(load_target("mockup"), CAMERA)
    run = SyntheticRun(duration_s=1.0, camera=CAMERA, target="mockup", render=render, frame=mode)
    path = run.write(tmp_path_factory.mktemp("one") / "run.mcap")
    with path.open("rb") as stream:
        return [
            Sent(
                channel.topic,
                schema.name,
                DRIVER if channel.topic.startswith(("/pmd", "/tf_static")) else None,
                message.log_time,
                message.data,
            )
            for schema, channel, message in make_reader(stream).iter_messages()
            if channel.topic != f"/{DIAGNOSTICS.name}"
        ]


def write(path, messages: list[Sent], *, named=True, publishers=None):
    """Write a log; its channels name their publishers if it is told so."""
    with path.open("wb") as target:
        writer = Writer(target)
        writer.start(profile="ros2")
        schemas, channels = {}, {}
        for number, sent in enumerate(sorted(messages, key=lambda sent: sent.log_ns)):
            if sent.type not in schemas:
                text = definition(sent.type).encode()
                schemas[sent.type] = writer.register_schema(sent.type, "ros2msg", text)
            place = sent.topic, sent.publisher if named else None
            if place not in channels:
                known = dict(zip((GID_METADATA, SESSION_METADATA), place[1] or (), strict=False))
                channels[place] = writer.register_channel(sent.topic, "cdr", schemas[sent.type], known)
            writer.add_message(channels[place], sent.log_ns, sent.data, sent.log_ns, number + 1)
        if publishers:
            writer.add_metadata(PUBLISHERS, {topic: json.dumps(each) for topic, each in publishers.items()})
        writer.finish()
    return path


def from_intruder(sent: Sent) -> Sent:
    """Return the message as another publisher sends it a little later, its stamp too."""
    sec, nanosec = struct.unpack_from("<iI", sent.data, 4)
    sec, nanosec = divmod(sec * 10**9 + nanosec + LATER_NS, 10**9)
    data = sent.data[:4] + struct.pack("<iI", sec, nanosec) + sent.data[12:]
    return Sent(sent.topic, sent.type, INTRUDER, sent.log_ns + LATER_NS, data)


def other_mount() -> Sent:
    mount = make_pose(translation_m=(1.0, 0.0, 0.0)) * T_CHASER_SENSOR
    message = write_transforms(EPOCH_NS, [(CHASER, optical_frame("pmd"), mount)])
    return Sent(f"/{TF_STATIC.name}", TF_STATIC.type, INTRUDER, EPOCH_NS + 10**7, bytes(encode(message)))


def replayed(path):
    """Return the outcome of a replay, its statuses, and its estimates as arrays."""
    with open_log(path) as log:
        done = replay(log, CONFIG)
    with open_log(done.out) as new:
        statuses = list(new.statuses(STATUSES))
        poses = [odometry.pose.as_matrix() for odometry in new.odometry(f"{REPLAY}/odometry")]
    return done, statuses, np.array(poses)


@pytest.fixture(scope="module")
def alone(messages, tmp_path_factory):
    return replayed(write(tmp_path_factory.mktemp("alone") / "run.mcap", messages))


def test_messages_of_a_second_publisher_are_not_used_and_counted(messages, alone, tmp_path):
    theirs = [from_intruder(sent) for sent in messages if sent.topic.startswith("/pmd")]
    done, statuses, poses = replayed(write(tmp_path / "run.mcap", [*messages, other_mount(), *theirs]))
    assert sum(done.second_publisher.values()) == len(theirs)
    assert set(done.second_publisher) == {sent.topic[1:] for sent in theirs}
    assert [each.stamp_ns for each in statuses] == [each.stamp_ns for each in alone[1]]
    np.testing.assert_array_equal(poses, alone[2])
    assert not done.undivided


def test_a_log_that_does_not_tell_publishers_apart_is_used_whole_and_says_so(messages, alone, tmp_path):
    theirs = [from_intruder(sent) for sent in messages if sent.topic.startswith("/pmd")]
    depth = "/pmd/depth/image_raw"
    gids = {depth: [{"gid": DRIVER[0]}, {"gid": INTRUDER[0]}, {"gid": INTRUDER[0]}]}
    path = write(tmp_path / "run.mcap", [*messages, *theirs], named=False, publishers=gids)
    done, statuses, _ = replayed(path)
    assert done.undivided == {depth[1:]: 2}
    assert not done.second_publisher
    assert len(statuses) == 2 * len(alone[1])


def test_a_successor_is_used_as_soon_as_the_publisher_before_it_has_ended(messages, alone, tmp_path):
    middle_ns = EPOCH_NS + 450_000_000
    before = [sent for sent in messages if sent.log_ns < middle_ns or not sent.topic.startswith("/pmd")]
    after = [
        Sent(sent.topic, sent.type, INTRUDER, sent.log_ns, sent.data)
        for sent in messages
        if sent.log_ns >= middle_ns and sent.topic.startswith("/pmd")
    ]
    goes_on = diagnostic(5.0, 0, "")
    done, _, poses = replayed(write(tmp_path / "run.mcap", [*before, *after, goes_on]))
    assert not done.second_publisher
    np.testing.assert_array_equal(poses, alone[2])


def diagnostic(time_s: float, resets: int, request: str) -> Sent:
    values = {f"published/{STATUS.name}": "1", "commands/reset": str(resets), "command/reset": request}
    stamp_ns = EPOCH_NS + round(1e9 * time_s)
    told = Diagnostic(stamp_ns=stamp_ns, name="estimator", level=Health.OK, message="", values=values)
    data = bytes(encode(write_diagnostics([told])))
    return Sent(f"/{DIAGNOSTICS.name}", DIAGNOSTICS.type, None, stamp_ns, data)


@pytest.mark.parametrize(("told_s", "frame_s"), [(0.75, 0.6), (0.95, 0.9)])
def test_a_reset_is_repeated_at_the_frame_at_which_the_live_track_ended(
    messages, tmp_path, monkeypatch, told_s, frame_s
):
    happened: list[float | ResetRequest] = []
    process, request_reset = Estimator.process, Estimator.request_reset

    def processing(self, arrived):
        happened.append(round((arrived.stamp_ns - EPOCH_NS) * 1e-9, 1))
        return process(self, arrived)

    def resetting(self, request):
        happened.append(request)
        return request_reset(self, request)

    monkeypatch.setattr(Estimator, "process", processing)
    monkeypatch.setattr(Estimator, "request_reset", resetting)
    request = ResetRequest(pose=T_CHASER_SENSOR * approach(0.6))
    before = diagnostic(told_s - 0.2, 0, "")
    told = [diagnostic(0.0, 0, ""), before, diagnostic(told_s, 1, request.model_dump_json())]
    done, *_ = replayed(write(tmp_path / "run.mcap", [*messages, *told]))
    assert (done.resets, done.unknown_resets) == (1, 0)
    (place,) = (k for k, each in enumerate(happened) if isinstance(each, ResetRequest))
    np.testing.assert_allclose(happened[place].pose.as_matrix(), request.pose.as_matrix(), atol=1e-12)
    assert happened[place - 1 : place + 2 : 2] == [pytest.approx(frame_s - 0.1), frame_s]


def test_resets_whose_requests_are_not_in_the_log_are_counted(messages, tmp_path):
    told = [diagnostic(0.0, 0, ""), diagnostic(0.75, 3, ResetRequest().model_dump_json())]
    done, *_ = replayed(write(tmp_path / "run.mcap", [*messages, *told]))
    assert (done.resets, done.unknown_resets) == (1, 2)
