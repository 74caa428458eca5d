"""Logs as they are met: folders, parts, logs of others, long ones."""

import os
from io import SEEK_CUR

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from mcap_ros2.writer import Writer as Ros2Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from synthetic_log import EPOCH_NS, SyntheticRun

from rpod_analysis import AnalysisError, find_sensors, open_log, pmd_frames, read_run
from rpod_analysis.errors import NoLogError
from rpod_analysis.log.log_file import files_of
from rpod_analysis.recovery import recover
from rpod_schemas.logs import MESSAGE_ENCODING, SCHEMA_ENCODING
from rpod_schemas.messages import read_image
from rpod_schemas.rmw.cdr import definition, typestore
from rpod_schemas.texts import is_count
from rpod_schemas.topics import DEPTH, TRUTH

SECOND = 1_000_000_000


@pytest.fixture(scope="module")
def ours(tmp_path_factory):
    return SyntheticRun().write(tmp_path_factory.mktemp("log") / "run.mcap")


@pytest.fixture(scope="module")
def bag(ours, tmp_path_factory):
    """The same messages as rosbag2 records them: a folder, sequence numbers of 0, no records of ours."""
    folder = tmp_path_factory.mktemp("bag") / "recorded"
    with open_log(ours) as log, BagWriter(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            name: writer.add_connection(f"/{name}", info.type, typestore=typestore())
            for name, info in log.topics.items()
        }
        for logged in log.messages():
            writer.write(connections[logged.topic], logged.log_ns, logged.payload)
    return folder


def test_a_log_that_rosbag2_wrote_is_read_and_scored_like_ours(bag, ours):
    with open_log(bag) as log, open_log(ours) as own:
        assert log.topics == own.topics
        assert [m.payload for m in log.messages()] == [m.payload for m in own.messages()]
        assert [f.stamp_ns for f in pmd_frames(log, "pmd")] == [f.stamp_ns for f in pmd_frames(own, "pmd")]
        run, reference = read_run(log), read_run(own)
        np.testing.assert_array_equal(run.errors.position_m, reference.errors.position_m)
        assert all(count.missed == 0 for count in run.account.frames().values())
        assert (log.configuration, log.counts) == ({}, {})


def test_a_sensor_under_its_drivers_topics_is_read_by_the_recorded_configuration(ours, tmp_path):
    names = {
        "pmd/depth/image_raw": "cam/depth",
        "pmd/camera_info": "cam/info",
        "pmd/amplitude/image_raw": "cam/ir",
    }
    folder, infos = tmp_path / "foreign", 0
    with open_log(ours) as log, BagWriter(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        wanted = [frame.stamp_ns for frame in pmd_frames(log, "pmd")]
        connections = {
            name: writer.add_connection(f"/{new}", log.topics[name].type, typestore=typestore())
            for name, new in names.items()
            if name in log.topics
        }
        for logged in log.messages(*connections):
            infos += logged.topic == "pmd/camera_info"
            if logged.topic != "pmd/camera_info" or infos % 10 == 1:
                writer.write(connections[logged.topic], logged.log_ns, logged.payload)
    topics = dict(zip(("depth", "camera_info", "amplitude"), names.values(), strict=True))
    source = {"topics": topics, "stamp": "start", "duration_s": 0.02}
    entry = {"kind": "pmd", "name": "front", "source": source}
    with open_log(folder) as log:
        log.__dict__["configuration"] = {"estimator": {"sensors": [entry]}}
        sensor = find_sensors(log)["front"]
        frames = list(pmd_frames(log, "front"))
        first_ns = next(log.messages("cam/depth", start_ns=0)).log_ns
        later = list(pmd_frames(log, "front", start_ns=first_ns + SECOND // 4))
    assert (sensor.kind, sensor.leading.name) == ("pmd", "cam/depth")
    assert [frame.stamp_ns - 10_000_000 for frame in frames] == wanted
    assert 0 < len(later) < len(frames)


def test_types_of_others_are_decoded_by_the_definition_in_their_log(tmp_path):
    path = tmp_path / "others.mcap"
    with path.open("wb") as stream:
        writer = Ros2Writer(stream)
        text = "std_msgs/Header header\nfloat32[] readings_v\nother_msgs/Inner inner\n"
        parts = {
            "other_msgs/Inner": "uint8 level\n",
            "std_msgs/Header": None,
            "builtin_interfaces/Time": None,
        }
        parts["std_msgs/Header"] = "builtin_interfaces/Time stamp\nstring frame_id\n"
        parts["builtin_interfaces/Time"] = "int32 sec\nuint32 nanosec\n"
        text += "".join(f"{'=' * 80}\nMSG: {name}\n{part}" for name, part in parts.items())
        schema = writer.register_msgdef("other_msgs/Probe", text)
        header = {"stamp": {"sec": 3, "nanosec": 0}, "frame_id": "probe"}
        message = {"header": header, "readings_v": [1.0, 2.5], "inner": {"level": 7}}
        writer.write_message("/lab/probe", schema, message, log_time=5)
        writer.finish()
    with open_log(path, namespace="lab") as log:
        assert log.topics["probe"].type == "other_msgs/msg/Probe"
        decoded = next(log.messages("probe")).decode()
        assert decoded.readings_v.tolist() == [1.0, 2.5]
        assert (decoded.header.frame_id, decoded.inner.level) == ("probe", 7)


def test_arrays_are_views_of_the_messages_bytes(ours):
    with open_log(ours) as log:
        logged = next(log.messages(DEPTH.of("pmd")))
        image = read_image(logged.decode())
        assert np.shares_memory(image, np.frombuffer(logged.payload, np.uint8))


def parts_of(folder, *, cuts=(0.55, 1.05)):
    edges = (-np.inf, *cuts, np.inf)
    return [
        SyntheticRun(part=(edges[k], edges[k + 1])).write(folder / f"run-{k}.mcap")
        for k in range(len(cuts) + 1)
    ]


def test_a_folder_is_one_log(tmp_path, ours):
    parts = parts_of(tmp_path)
    with open_log(tmp_path) as log, open_log(ours) as whole:
        assert log.paths == tuple(parts)
        assert [m.payload for m in log.messages()] == [m.payload for m in whole.messages()]
        assert (log.start_ns, log.end_ns) == (whole.start_ns, whole.end_ns)


def test_in_a_folder_the_recovered_log_stands_for_the_damaged_one_and_replays_are_left_out(tmp_path):
    parts = parts_of(tmp_path)
    parts[-1].write_bytes(parts[-1].read_bytes()[:-500])
    (tmp_path / "run-0.replay.mcap").write_bytes(b"")
    with pytest.raises(AnalysisError, match=r"run-2\.mcap: the log is truncated"):
        open_log(tmp_path)
    recovery = recover(parts[-1])
    with open_log(tmp_path) as log:
        assert [str(path) for path in log.paths] == [*map(str, parts[:2]), recovery.out]
        assert len(read_run(log).estimates) == 21


def test_files_that_overlap_in_time_are_read_in_the_order_of_arrival(tmp_path, ours):
    with open_log(ours, parts_of(tmp_path)[1]) as log:
        arrivals = [logged.log_ns for logged in log.messages(TRUTH)]
        assert arrivals == sorted(arrivals)
        assert len(arrivals) == log.topics[TRUTH.name].count > 503


class Reads:
    """A stream that counts what is read of it."""

    def __init__(self, stream):
        self._stream, self.bytes = stream, 0

    def read(self, size=-1):
        data = self._stream.read(size)
        self.bytes += len(data)
        return data

    def __getattr__(self, name):
        return getattr(self._stream, name)


def test_ten_gigabytes_are_opened_and_sliced_by_reading_a_few_kilobytes(tmp_path):
    """A sparse file: between two chunks there is a hole of 50 MB, as an attachment that no index names."""
    path, hole = tmp_path / "long.mcap", 50_000_000
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.LZ4)
        writer.start(profile="ros2")
        schema = writer.register_schema(TRUTH.type, SCHEMA_ENCODING, definition(TRUTH.type).encode())
        channel = writer.register_channel("/truth/odometry", MESSAGE_ENCODING, schema)
        for second in range(200):
            writer.add_message(channel, EPOCH_NS + second * SECOND, bytes(1000), EPOCH_NS, second + 1)
            writer.flush()
            stream.write(b"\x09" + hole.to_bytes(8, "little"))
            stream.seek(hole, SEEK_CUR)
        writer.finish()
    assert path.stat().st_size > 10_000_000_000
    assert path.stat().st_blocks * 512 < 10_000_000
    with open_log(path) as log:
        checked = log._parts[0].reader._stream
        stream = checked._stream = Reads(checked._stream)
        middle_ns = (log.start_ns + log.end_ns) // 2
        found = list(log.messages(TRUTH, start_ns=middle_ns, end_ns=middle_ns + 10 * SECOND))
        assert [logged.sequence for logged in found] == list(range(101, 111))
        assert log.topics[TRUTH.name].count == 200
        assert 0 < stream.bytes < 10_000
    os.truncate(path, 0)


def test_a_path_that_the_system_cannot_look_up_is_no_log(tmp_path):
    with pytest.raises(NoLogError):
        files_of(tmp_path / ("x" * 5000))


@pytest.mark.parametrize(
    ("text", "count"),
    [("0", True), ("18446744073709551615", True), ("9" * 5000, False), ("1.5", False), ("-1", False)],
)
def test_a_count_has_twenty_digits_at_most(text, count):
    assert is_count(text) is count
