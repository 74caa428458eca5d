"""A driver in a process of its own: its frames come whole, its errors are told, and nothing is left."""

import ast
import io
import json
import os
import struct
import sys
import time
import tomllib
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from rpod_driver.adapters.process import ProcessConfig, open_driver
from rpod_driver.errors import ForeignDriverError, StoppedError
from rpod_driver.foreign import frame_pipe
from rpod_schemas.sensors import sensor_kind

ROOT = Path(__file__).parents[3]
SCRIPT = ROOT / "tests" / "driver_script.py"
OUSTER = ROOT / "tests" / "recordings" / "ouster" / "os1-32.frames"


def driver(*arguments, kind="pmd", python=sys.executable, start_s=20.0):
    device = {"python": python, "script": SCRIPT, "arguments": arguments, "start_s": start_s}
    return open_driver(ProcessConfig.model_validate({"name": "front", "kind": kind, "device": device}))


def frames(*arguments, **options):
    opened = driver(*arguments, **options)
    opened.connect()
    with closing(opened):
        return [frame for frame in opened.frames() if frame is not None]


def failure(*arguments, **options):
    with pytest.raises(ForeignDriverError) as caught:
        frames(*arguments, **options)
    return str(caught.value)


@given(
    arrays.arrays(
        st.sampled_from([np.float32, np.float64, np.uint8, np.uint16, np.int64, np.bool_]),
        arrays.array_shapes(min_dims=0, max_dims=3, min_side=0),
    ),
    st.dictionaries(st.text(max_size=5), st.integers(-(2**60), 2**60)),
)
def test_a_message_comes_back_as_it_was_sent(array, given_fields):
    stream = io.BytesIO()
    frame_pipe.Sender(stream).send("frame", {"a": array, "b": array.T}, told=given_fields)
    stream.seek(0)
    message = frame_pipe.receive(stream)
    assert message.kind == "frame"
    assert message.fields == {"told": given_fields}
    assert message.arrays["a"].tobytes() == array.tobytes()
    assert np.array_equal(message.arrays["b"], array.T, equal_nan=array.dtype.kind == "f")
    assert frame_pipe.receive(stream) is None


def framed(header: dict) -> bytes:
    text = json.dumps(header).encode()
    return struct.pack("<4sI", b"RPF1", len(text)) + text


@pytest.mark.parametrize(
    ("sent", "reason"),
    [
        (b"Traceback", "something else writes there"),
        (struct.pack("<4sI", b"RPF1", 2**31), "a header of 2147483648 bytes"),
        (struct.pack("<4sI", b"RPF1", 4) + b"{{{{", "cannot be read"),
        (framed({"kind": "frame"}), "KeyError"),
        (framed({"kind": "firmware", "fields": {}, "arrays": []}), "kind 'firmware'"),
        (
            framed({"kind": "frame", "fields": {}, "arrays": [{"name": "a", "dtype": "O", "shape": [1]}]}),
            "is O",
        ),
        (
            framed(
                {"kind": "frame", "fields": {}, "arrays": [{"name": "a", "dtype": "<f8", "shape": [9**9]}]}
            ),
            "at most 268435456",
        ),
        (
            framed({"kind": "frame", "fields": {}, "arrays": [{"name": "a", "dtype": "<f4", "shape": [2]}]})
            + b"12",
            "ends 6 bytes before",
        ),
    ],
)
def test_what_is_no_message_is_refused_with_its_fault(sent, reason):
    with pytest.raises(ValueError, match=reason):
        frame_pipe.receive(io.BytesIO(sent))


def test_frames_come_in_their_order_and_the_source_ends():
    got = frames("ten")
    assert [frame.depth_m[0, 0] for frame in got] == list(range(10))
    assert {frame.amplitude.dtype for frame in got} == {np.dtype(np.uint16)}
    assert {frame.camera.fx for frame in got} == {5.0}
    assert (np.diff([frame.stamp_ns for frame in got]) > 0).all()


def test_a_kind_that_names_no_model_of_a_frame_is_refused_with_those_that_do(monkeypatch):
    without = replace(sensor_kind("pmd"), frame=None)
    monkeypatch.setattr("rpod_driver.foreign.process.sensor_kind", lambda _: without)
    reason = (
        "cannot bring what a PMD camera sends: its kind names no model of it; frames may be of lidar, pmd"
    )
    assert reason in failure("ten")


def test_what_a_library_prints_is_no_frame(caplog):
    with caplog.at_level("INFO"):
        assert len(frames("printing")) == 2
    assert "process: a library prints this" in caplog.text
    assert "process: and this from compiled code" in caplog.text


def test_a_process_that_crashes_is_told_with_its_last_words():
    text = failure("crash")
    assert "ended with exit code 7" in text
    assert "bus error in the library" in text


@pytest.mark.parametrize(
    ("does", "reason"),
    [
        ("tell", "says: the sensor is too hot"),
        ("garbage", "something else writes there"),
        ("early", "begins with 'frame'"),
        ("pausing_for_ever", "sends idle with pause_s 'for ever'; send a number of seconds"),
        ("wrong", "sends no PmdFrame: camera"),
        ("no_such_thing", "KeyError: 'no_such_thing'"),
    ],
)
def test_an_error_of_the_process_is_told(does, reason):
    assert reason in failure(does)


def test_a_process_that_does_not_open_its_device_is_ended_in_time():
    assert "did not open its device within 0.5 s (device.start_s)" in failure("hang", start_s=0.5)


@pytest.mark.timeout(60)
def test_a_stop_ends_the_wait_for_the_device_and_the_watchdog_is_told_meanwhile(monkeypatch):
    stop, beats = Event(), []

    def alive():
        beats.append(1)
        if len(beats) == 2:
            stop.set()

    monkeypatch.setattr("rpod_driver.foreign.process.manager.alive", alive)
    opened = driver("hang", start_s=600.0)
    opened.take_stop(stop)
    with pytest.raises(StoppedError, match="'front' was stopped before its device was open"):
        opened.connect()
    assert len(beats) == 2


def test_an_interpreter_that_is_not_there_is_named():
    assert "correct device.python" in failure("ten", python="/opt/no/python")


def test_a_silent_device_is_told_as_none_and_its_process_ends_with_the_host(tmp_path):
    opened = driver("pid", str(tmp_path / "pid"))
    opened.connect()
    got = opened.frames()
    assert next(got) is not None
    assert next(got) is None
    process = int((tmp_path / "pid").read_text())
    opened.close()
    opened.close()  # nothing is left to close
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)


def test_a_pause_that_the_process_announces_is_told_to_the_host():
    opened = driver("pausing")
    opened.connect()
    with closing(opened):
        got = opened.frames()
        assert next(got) is not None
        assert opened.due_s() < time.monotonic()
        assert next(got) is None
        assert 0.5 < opened.due_s() - time.monotonic() <= 1.5
        assert sum(frame is not None for frame in got) == 1


@pytest.mark.timeout(30)
def test_what_the_process_started_does_not_hold_the_driver_open():
    opened = driver("parent")
    opened.connect()
    assert next(opened.frames()) is not None
    opened.close()


def test_a_driver_can_be_opened_again_after_a_crash():
    opened = driver("crash")
    for _ in range(2):
        opened.connect()
        got = opened.frames()
        assert next(got).depth_m[0, 0] == 0
        opened.close()


def test_the_process_sees_nothing_of_this_environment():
    text = failure("environment")
    told = ast.literal_eval(text.partition("says: ")[2])
    assert told["venv"] is None
    assert not [name for name in told["modules"] if name.partition(".")[0] in ("rpod_driver", "zenoh")]
    assert str(ROOT / "services" / "rpod_driver" / "foreign") in told["path"]


def test_the_base_install_has_no_library_of_a_device():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    libraries = {"ifm3dpy", "harvesters", "genicam", "pyrealsense2", "ouster-sdk"}
    in_base = [*project["dependencies"], *extras["all"], *extras["analysis"], *extras["view"]]
    assert not [line for line in in_base if any(name in line for name in libraries)]
    assert not [line for lines in extras.values() for line in lines if "ouster" in line]


def test_the_stamp_of_a_scan_is_mapped_by_the_arrival_of_its_last_point():
    begun_ns = time.time_ns()
    (got,) = frames("scan", kind="lidar")
    assert begun_ns <= got.stamp_ns + 4_000_000_000 <= time.time_ns()


def test_partial_scans_are_told_and_not_for_each(caplog):
    assert len(frames("partial", kind="lidar")) == 12
    told = [record.message for record in caplog.records if "lacks" in record.message]
    assert told == [
        "front: lacks 7 columns (1 such frames so far)",
        "front: lacks 7 columns (10 such frames so far)",
    ]


def test_a_scan_of_an_ouster_is_in_boresight_axes_and_stamped_with_its_middle(caplog):
    with caplog.at_level("INFO"):
        (scan,) = frames("recorded", str(OUSTER), kind="lidar")
    assert "OS-1-32-G v2.1.1, 32 x 1024" in caplog.text
    assert "the newest is 3577.184 s" in caplog.text
    range_m = np.linalg.norm(scan.points_m, axis=-1)
    assert scan.points_m.shape == (32, 128, 3)
    assert np.isfinite(range_m).mean() > 0.6
    ahead = np.isfinite(range_m)
    assert (scan.points_m[ahead][:, 2] > 0.8 * range_m[ahead]).all()
    elevations = np.degrees(np.nanmedian(np.arcsin(-scan.points_m[..., 1] / range_m), axis=1))
    assert elevations[0] == pytest.approx(12.9, abs=0.3)
    assert (np.diff(elevations) < 0).all()
    assert np.nanmax(np.abs(scan.time_s)) < 0.01
