"""The logger daemon on a real bus: nothing is lost in a burst, and the control plane does what it says."""

import json
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread
from time import monotonic

import numpy as np
import pytest
from live_bus import first
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from rpod_logger.daemon import run
from rpod_runtime import Inbox, QueryFailedError
from rpod_runtime.process.reloading import reloader
from rpod_runtime.sensors import CameraPublisher
from rpod_schemas.config.facility.logger import LoggerConfig
from rpod_schemas.control import LogReply, LogRequest, StatusReply
from rpod_schemas.logs import TopicCount
from rpod_schemas.messages import read_diagnostics, write_clock
from rpod_schemas.poses import make_pose
from rpod_schemas.reload import ReloadReply
from rpod_schemas.rmw.cdr import encode, type_hash
from rpod_schemas.rmw.wire import Attachment
from rpod_schemas.topics import CLOCK, DEPTH, DIAGNOSTICS, ESTIMATE
from rpod_schemas.types import Camera, Health, PmdFrame, PmdInfo

TIMEOUT_S = 60.0
CAMERA = Camera(width=352, height=287, fx=400.0, fy=400.0, cx=175.5, cy=143.0)
INFO = PmdInfo(
    modulation_frequency_hz=[20e6], integration_time_s=1e-3, electrons_per_count=10.0, saturation_count=4e3
)


@contextmanager
def logger(config: LoggerConfig):
    """Run the daemon in a thread; stop it, and raise what it raised, at the end."""
    stop, failures = Event(), []

    def body() -> None:
        try:
            run(config, version="test", stop=stop)
        except Exception as error:  # noqa: BLE001 - handed to the test
            failures.append(error)

    thread = Thread(target=body)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(TIMEOUT_S)
    assert not thread.is_alive()
    if failures:
        raise failures[0]


def status_with(node, state="ready", **least: int) -> StatusReply:
    """Return the logger's status once its counters have reached what is asked for."""
    deadline_s = monotonic() + TIMEOUT_S
    counters: dict[str, int] = {}
    while monotonic() < deadline_s:
        try:
            status = node.ask("logger", "status", StatusReply, timeout_s=1.0)
        except QueryFailedError:
            continue
        counters = status.counters
        if status.state == state and all(counters.get(name, 0) >= count for name, count in least.items()):
            return status
        node.stop.wait(0.02)
    raise AssertionError(f"the logger did not reach {least}: {counters}")


def metadata(path: Path, name: str) -> dict[str, str]:
    with path.open("rb") as stream:
        return [item.metadata for item in make_reader(stream).iter_metadata() if item.name == name][-1]


def counts(path: Path) -> dict[str, TopicCount]:
    return {topic: TopicCount.model_validate_json(text) for topic, text in metadata(path, "counts").items()}


def sequences(path: Path, topic: str) -> list[int]:
    with path.open("rb") as stream:
        return [m.sequence for _, _, m in make_reader(stream).iter_messages([topic], log_time_order=False)]


def frame(number: int) -> PmdFrame:
    depth_m = np.full((287, 352), number, np.float32)
    return PmdFrame(
        stamp_ns=number, frame_id="", depth_m=depth_m, amplitude=depth_m.astype(np.uint16), camera=CAMERA
    )


def test_a_burst_of_frames_and_truth_is_recorded_without_a_gap(bus, tmp_path):
    node = bus.node("publisher")
    with logger(LoggerConfig(bus=bus.config, directory=tmp_path, name="run")):
        status_with(node)
        camera = CameraPublisher(node, "pmd", T_chaser_sensor=make_pose(), info=INFO)
        clock = node.publisher(CLOCK)
        for number in range(1, 61):
            camera.publish(frame(number))
            for tick in range(10):
                clock.publish(write_clock(number * 10 + tick))
            if number % 5 == 0:  # stay within the publishers' caches, as lockstep does
                status_with(node, **{"received/clock": number * 10, "received/pmd/depth/image_raw": number})
        status = status_with(
            node, **{"written/clock": 600, "written/pmd/depth/image_raw": 60, "received/pmd/camera_info": 60}
        )
    path = tmp_path / "run.mcap"
    assert status.counters["missed/clock"] == status.counters["missed/pmd/depth/image_raw"] == 0
    count = counts(path)
    clocks = count["/clock"]
    assert (clocks.received, clocks.written, clocks.missed) == (600, 600, 0)
    assert {name: count[f"/pmd/{name}"].written for name in ("depth/image_raw", "camera_info", "info")} == {
        "depth/image_raw": 60,
        "camera_info": 60,
        "info": 1,
    }
    assert sequences(path, "/pmd/depth/image_raw") == list(range(1, 61))
    with AnyReader([path]) as bag:
        depths = [
            bag.deserialize(data, connection.msgtype).data.view(np.float32)[0]
            for connection, _, data in bag.messages([c for c in bag.connections if "depth" in c.topic])
        ]
    assert depths == list(range(1, 61))
    assert json.loads(metadata(path, "configuration")["publisher"])["instance"] == "publisher"
    assert json.loads(metadata(path, "configuration")["logger"])["name"] == "run"


def test_what_was_published_before_the_logger_came_is_fetched(bus, tmp_path):
    node = bus.node("publisher")
    camera = CameraPublisher(node, "pmd", T_chaser_sensor=make_pose(), info=INFO)
    for number in range(1, 11):
        camera.publish(frame(number))
    with logger(LoggerConfig(bus=bus.config, directory=tmp_path, name="run")):
        status_with(
            node,
            **{"written/pmd/depth/image_raw": 10, "written/pmd/info": 1, "written/tf_static": 1},
        )
    assert sequences(tmp_path / "run.mcap", "/pmd/depth/image_raw") == list(range(1, 11))


def test_split_stop_and_start_by_query(bus, tmp_path):
    node = bus.node("publisher")
    clock, mount = node.publisher(CLOCK), CameraPublisher(node, "pmd", T_chaser_sensor=make_pose(), info=INFO)
    with logger(LoggerConfig(bus=bus.config, directory=tmp_path, name="run")):
        for number in range(1, 6):
            clock.publish(write_clock(number))
        mount.publish(frame(1))
        status_with(node, **{"received/clock": 5, "received/tf_static": 1, "received/pmd/info": 1})
        split = node.ask("logger", "split", LogReply, LogRequest(name="second"))
        for number in range(6, 9):
            clock.publish(write_clock(number))
        status_with(node, **{"written/clock": 8})
        closed = node.ask("logger", "stop", LogReply)
        with pytest.raises(QueryFailedError, match="not recording"):
            node.ask("logger", "stop", LogReply)
        started = node.ask("logger", "start", LogReply, LogRequest(name="second"))
        with pytest.raises(QueryFailedError, match="already recording"):
            node.ask("logger", "start", LogReply)
    assert [Path(reply.path).name for reply in (split, closed, started)] == [
        "second.mcap",
        "second.mcap",
        "second_0002.mcap",
    ]
    assert sequences(tmp_path / "run.mcap", "/clock") == [1, 2, 3, 4, 5]
    assert sequences(tmp_path / "second.mcap", "/clock") == [6, 7, 8]
    for name in ("second.mcap", "second_0002.mcap"):
        with (tmp_path / name).open("rb") as stream:
            first = [c.topic for _, c, _ in make_reader(stream).iter_messages(log_time_order=False)][:2]
        assert sorted(first) == ["/pmd/info", "/tf_static"]


def test_a_message_without_a_usable_attachment_is_counted_and_left_out(bus, tmp_path):
    node = bus.node("publisher")
    with logger(LoggerConfig(bus=bus.config, directory=tmp_path, name="run")):
        status_with(node)
        node.publisher(CLOCK).publish(write_clock(1))
        node._session.put(bus.config.keys.key(CLOCK), b"\x00\x01\x00\x00" + bytes(8), attachment=b"short")
        status = status_with(node, **{"written/clock": 1, "rejected/clock/malformed": 1})
    assert status.counters["received/clock"] == 1
    assert sequences(tmp_path / "run.mcap", "/clock") == [1]


def test_extra_keys_are_kept_as_they_came_and_icd_topics_are_not_doubled(bus, tmp_path):
    node = bus.node("publisher")
    config = LoggerConfig(bus=bus.config, directory=tmp_path, name="run", record_extra=("0/**",))
    with logger(config):
        status_with(node)
        node.publisher(CLOCK).publish(write_clock(1))
        node._session.put("0/lab/raw", b"any bytes", encoding="text/plain")
        status = status_with(node, **{"written/clock": 1, "written/lab/raw": 1})
    assert status.counters.get("rejected/clock/duplicate", 0) == 0
    path = tmp_path / "run.mcap"
    assert sequences(path, "/clock") == [1]
    with path.open("rb") as stream:
        ((schema, channel, message),) = make_reader(stream).iter_messages(["/lab/raw"])
    assert message.data == b"any bytes"
    assert (schema.name, schema.encoding, channel.message_encoding) == (
        "opaque",
        "",
        "application/octet-stream",
    )
    assert channel.metadata == {"key": "0/lab/raw", "encoding": "text/plain"}


def test_a_numbered_key_of_an_unknown_type_is_accounted_for_like_a_topic(bus, tmp_path):
    node = bus.node("publisher")
    key = "0/lab/lab_msgs::msg::dds_::Nobody_/RIHS01_00"
    config = LoggerConfig(bus=bus.config, directory=tmp_path, name="run", record_extra=("0/lab/**",))
    with logger(config):
        status_with(node)
        for sequence in (1, 2, 5, 5):
            node._session.put(key, b"bytes", attachment=Attachment(sequence, sequence, b"y" * 16).pack())
        status_with(node, **{f"written/{key.removeprefix('0/')}": 3})
    count = counts(tmp_path / "run.mcap")["/" + key.removeprefix("0/")]
    assert count == TopicCount(received=3, written=3, missed=2, duplicates=1)


def test_a_logger_that_cannot_write_lives_on_says_so_and_is_started_by_query(bus, tmp_path):
    node = bus.node("publisher")
    inbox = Inbox()
    node.subscribe(DIAGNOSTICS, inbox.put)
    blocker = tmp_path / "file"
    blocker.touch()
    with logger(LoggerConfig(bus=bus.config, directory=blocker / "logs", name="run")):
        status_with(node, "failed")
        clock = node.publisher(CLOCK)
        clock.publish(write_clock(1))
        status_with(node, "failed", **{"lost/clock": 1})
        said = first(inbox, lambda received: unhealthy(received.decode()))
        with pytest.raises(QueryFailedError, match="Not a directory"):
            node.ask("logger", "start", LogReply)
        blocker.unlink()
        started = node.ask("logger", "start", LogReply)
        clock.publish(write_clock(2))
        status_with(node, **{"written/clock": 1})
    assert "move it away, or set another directory, then the logger begins by itself" in said
    assert sequences(Path(started.path), "/clock") == [2]


def test_a_logger_begins_by_itself_once_its_folder_can_be_written(bus, tmp_path, monkeypatch):
    monkeypatch.setattr("rpod_logger.daemon._RETRY_S", 0.2)
    node, blocker = bus.node("publisher"), tmp_path / "file"
    blocker.touch()
    with logger(LoggerConfig(bus=bus.config, directory=blocker / "logs", name="run")):
        status_with(node, "failed")
        blocker.unlink()
        status_with(node)
        node.publisher(CLOCK).publish(write_clock(2))
        status_with(node, **{"written/clock": 1})
    assert sequences(blocker / "logs" / "run.mcap", "/clock") == [1]


def unhealthy(message) -> str:
    """Return what the logger complains of."""
    errors = [
        item.message
        for item in read_diagnostics(message)
        if item.name == "logger" and item.level is Health.ERROR
    ]
    return errors[0] if errors else ""


def test_health_names_the_log_and_a_gap_is_an_error(bus, tmp_path):
    node = bus.node("publisher")
    inbox = Inbox()
    node.subscribe(DIAGNOSTICS, inbox.put)
    errors: list[str] = []
    with logger(LoggerConfig(bus=bus.config, directory=tmp_path, name="run")):
        status_with(node)
        for sequence in (1, 4):
            attachment = Attachment(sequence, sequence, b"z" * 16).pack()
            payload = bytes(encode(write_clock(sequence)))
            node._session.put(bus.config.keys.key(CLOCK), payload, attachment=attachment)
        deadline_s = monotonic() + TIMEOUT_S
        while not errors and monotonic() < deadline_s:
            for received in inbox.wait(0.1):
                errors += [
                    item.message
                    for item in read_diagnostics(received.decode())
                    if item.name == "logger" and item.level is Health.ERROR
                ]
    assert "to run.mcap" in errors[0]
    assert "2 missed on the bus" in errors[0]


def test_the_ros_graph_shows_the_logger_as_subscriber_of_each_concrete_topic(bus, tmp_path):
    node = bus.node("publisher")
    topics = [DEPTH.of("front"), ESTIMATE.under("second"), CLOCK]
    for topic in topics:
        node.publisher(topic)
    selector = "@ros2_lv/0/*/*/*/MS/*/*/logger/*/*/*/*"
    wanted = {
        f"%{topic.name.replace('/', '%')}/{topic.wire_type}/{type_hash(topic.type)}" for topic in topics
    }
    shown: set[str] = set()
    deadline_s = monotonic() + TIMEOUT_S
    with logger(LoggerConfig(bus=bus.config, directory=tmp_path)):
        while not wanted <= shown and monotonic() < deadline_s:
            tokens = [
                str(reply.ok.key_expr) for reply in node._session.liveliness().get(selector) if reply.ok
            ]
            shown = {"/".join(token.split("/")[9:12]) for token in tokens}
            node.stop.wait(0.05)
    assert wanted <= shown
    assert not [name for name in shown if "*" in name]


def test_a_logger_that_reads_its_file_again_writes_its_next_file_elsewhere(bus, tmp_path):
    config = LoggerConfig(bus=bus.config, directory=tmp_path / "first", name="run")
    changed = config.model_copy(update={"directory": tmp_path / "second", "compression": "zstd"})
    reloader.begin(config, lambda: changed)
    asker, health = bus.node("asker"), Inbox()
    asker.subscribe(DIAGNOSTICS, health.put)
    with logger(config):
        status_with(asker)
        reply = asker.ask("logger", "reload", ReloadReply, timeout_s=TIMEOUT_S)
        assert reply.changed == {"directory": str(tmp_path / "second")}
        assert reply.needs_restart == ("compression",)
        status = asker.ask("logger", "status", StatusReply, timeout_s=TIMEOUT_S)
        assert status.configuration["directory"] == str(tmp_path / "second")
        assert status.configuration["compression"] == "lz4"
        path = Path(asker.ask("logger", "split", LogReply, timeout_s=TIMEOUT_S).path)
        told = first(health, lambda received: differs(read_diagnostics(received.decode())))
    assert path.parent == tmp_path / "second"
    assert told[0].level == Health.WARN


def differs(told):
    """Return the logger's diagnostics that say that its file is another."""
    text = "the file differs in compression: restart the service"
    return [item for item in told if item.name == "logger" and text in item.values.get("configuration", "")]
