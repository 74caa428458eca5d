"""Drivers on a real bus: what they deliver arrives, and what fails is told and tried again."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread
from time import monotonic

import numpy as np
import pytest
import yaml
from facility_process import until
from ros_client import RosClient, assignment, parameters

import rpod_driver
from rpod_driver import DriverError, Drops, StoppedError, run
from rpod_runtime import Inbox
from rpod_runtime.errors import QueryFailedError
from rpod_schemas.config.driver import DriverConfig
from rpod_schemas.control import Accepted, SettingsReply, SettingsRequest
from rpod_schemas.messages import (
    read_amplitude,
    read_camera,
    read_depth,
    read_diagnostics,
    read_lidar_info,
    read_points,
    read_stamp,
    read_transforms,
)
from rpod_schemas.topics import (
    AMPLITUDE,
    CAMERA_INFO,
    DEPTH,
    DIAGNOSTICS,
    LIDAR_INFO,
    PMD_INFO,
    POINTS,
    TF_STATIC,
)
from rpod_schemas.types import Camera, Diagnostic, Health, LidarInfo, LidarScan, PmdFrame, PmdInfo, SensorSync

TIMEOUT_S = 60.0
EXAMPLE = Path(rpod_driver.__file__).parent / "examples" / "recorded_frames.py"
CAMERA = Camera(width=4, height=3, fx=5.0, fy=6.0, cx=1.5, cy=1.0)
STAMP_NS = 1_700_000_000_000_000_000
PERIOD_NS = 20_000_000
PMD = PmdInfo(
    modulation_frequency_hz=[2e7], integration_time_s=1e-3, electrons_per_count=9, saturation_count=1
)


class Receiver:
    """Keeps the messages of a node's subscriptions by topic."""

    def __init__(self, node, *topics) -> None:
        self._inbox = Inbox()
        self.messages: dict[str, list] = {topic.name: [] for topic in topics}
        for topic in topics:
            node.subscribe(topic, self._inbox.put, recover=True, history=True)

    def until(self, satisfied: Callable[[dict[str, list]], bool]) -> dict[str, list]:
        deadline_s = monotonic() + TIMEOUT_S
        while not satisfied(self.messages):
            assert monotonic() < deadline_s, {name: len(items) for name, items in self.messages.items()}
            for received in self._inbox.wait(0.1):
                self.messages[received.topic.name].append(received.decode())
        return self.messages

    def diagnostic(self, satisfied: Callable[[Diagnostic], bool], name: str = "driver") -> Diagnostic:
        def told(messages: dict[str, list]) -> list[Diagnostic]:
            told = [item for message in messages["diagnostics"] for item in read_diagnostics(message)]
            return [item for item in told if item.name == name and satisfied(item)]

        return told(self.until(lambda messages: bool(told(messages))))[0]


@contextmanager
def hosted(driver, config: DriverConfig):
    """Run the host in a thread; stop it, and raise what it raised, at the end."""
    stop, failures = Event(), []

    def body() -> None:
        try:
            run(driver, config, version="test", stop=stop)
        except Exception as error:  # noqa: BLE001 - handed to the test
            failures.append(error)

    thread = Thread(target=body)
    thread.start()
    try:
        yield stop
    finally:
        stop.set()
        thread.join(TIMEOUT_S)
    assert not thread.is_alive()
    assert not failures


def frame(number: int, **changes: object) -> PmdFrame:
    depth_m = np.full((3, 4), number, np.float32)
    fields = {"depth_m": depth_m, "amplitude": depth_m.astype(np.uint16), "camera": CAMERA} | changes
    return PmdFrame(stamp_ns=STAMP_NS + number * PERIOD_NS, frame_id="anything", **fields)


class Scripted:
    """A driver that does, connection by connection, what a test tells it."""

    def __init__(self, *scripts: Callable[[], Iterator], info: object = None) -> None:
        self._scripts = list(scripts)
        self._info = info
        self.opened = self.closed = 0

    def connect(self):
        self.opened += 1
        return self._info

    def frames(self):
        return self._scripts.pop(0)() if len(self._scripts) > 1 else self._scripts[0]()

    def close(self) -> None:
        self.closed += 1

    def sync(self):
        return SensorSync(ptp="locked", trigger="hardware")


def silent() -> Iterator[None]:
    pause = Event()
    while True:
        pause.wait(0.02)
        yield None


def test_the_example_plays_a_recording_as_a_process(bus, tmp_path):
    rng = np.random.default_rng(7)
    depth_m = rng.uniform(1.0, 9.0, (12, 3, 4)).astype(np.float32)
    depth_m[:, 0, 0] = np.nan
    stamps_ns = STAMP_NS + PERIOD_NS * np.arange(12)
    amplitude = rng.integers(0, 4095, (12, 3, 4), dtype=np.uint16)
    np.savez(
        tmp_path / "f.npz",
        stamp_ns=stamps_ns,
        depth_m=depth_m,
        amplitude=amplitude,
        camera=[5.0, 6.0, 1.5, 1.0],
    )
    document = yaml.safe_load(EXAMPLE.with_suffix(".yaml").read_text())
    document["bus"] = {"connect": bus.endpoint}
    (tmp_path / "driver.yaml").write_text(yaml.safe_dump(document))
    receiver = Receiver(
        bus.node("receiver"),
        *(topic.of("pmd") for topic in (DEPTH, AMPLITUDE, CAMERA_INFO)),
        TF_STATIC,
        DIAGNOSTICS,
    )
    started_ns = time.time_ns()
    ended = subprocess.run(
        [sys.executable, EXAMPLE, tmp_path / "f.npz", tmp_path / "driver.yaml"],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    messages = receiver.until(
        lambda messages: (
            all(len(messages[topic.of("pmd").name]) == 12 for topic in (DEPTH, AMPLITUDE, CAMERA_INFO))
            and len(messages["tf_static"]) == 1
        )
    )
    depths, amplitudes = messages["pmd/depth/image_raw"], messages["pmd/amplitude/image_raw"]
    played_ns = np.array([read_stamp(message.header) for message in depths])
    np.testing.assert_array_equal(played_ns - played_ns[0], stamps_ns - stamps_ns[0])
    assert played_ns[0] >= started_ns
    assert np.array_equal([read_depth(message) for message in depths], depth_m, equal_nan=True)
    assert np.array_equal([read_amplitude(message) for message in amplitudes], amplitude)
    for message in messages["pmd/camera_info"]:
        assert read_camera(message).model_dump(exclude={"distortion"}) == CAMERA.model_dump(
            exclude={"distortion"}
        )
    (mount,) = read_transforms(messages["tf_static"][0])
    assert mount[1:3] == ("chaser", "pmd_optical")
    assert mount[3].translation.tolist() == [0.0, 0.1, 0.0]
    last = receiver.diagnostic(lambda item: item.values.get("published/pmd/depth/image_raw") == "12")
    assert (last.level, last.message) == (Health.OK, "the source has ended")
    assert last.values["frames/pmd"] == "12"
    assert float(last.values["rate_hz"]) > 0.0


def test_a_configuration_that_cannot_be_used_is_told_in_one_line(tmp_path):
    (tmp_path / "driver.yaml").write_text("kind: radar\nname: pmd\n")
    ended = subprocess.run(
        [sys.executable, EXAMPLE, "none.npz", tmp_path / "driver.yaml"],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert ended.returncode == 2
    assert len(ended.stderr.splitlines()) == 1
    assert "driver.yaml: kind" in ended.stderr


def test_a_sensor_that_fails_is_closed_told_and_connected_again(bus):
    def breaks() -> Iterator[PmdFrame]:
        yield frame(1)
        raise DriverError("the cable is out")

    def works() -> Iterator[PmdFrame | None]:
        yield frame(2)
        yield from silent()

    receiver = Receiver(bus.node("receiver"), DEPTH.of("pmd"), PMD_INFO.of("pmd"), DIAGNOSTICS)
    driver = Scripted(breaks, works, info=PMD)
    config = DriverConfig(bus=bus.config, kind="pmd", name="pmd", retry_s=0.3)
    with hosted(driver, config):
        broken = receiver.diagnostic(lambda item: item.message == "the cable is out")
        healthy = receiver.diagnostic(lambda item: item.values.get("frames/pmd") == "2")
        receiver.until(lambda got: len(got["pmd/depth/image_raw"]) == len(got["pmd/info"]) == 2)
    assert broken.level is Health.ERROR
    assert broken.values["failures/pmd"] == "1"
    assert healthy.level is Health.OK
    assert (driver.opened, driver.closed) == (2, 2)


def test_a_device_that_cannot_be_opened_is_tried_again_and_not_closed(bus):
    class Late(Scripted):
        def connect(self):
            super().connect()
            if self.opened < 3:
                raise OSError("no such device")

    receiver = Receiver(bus.node("receiver"), DEPTH.of("pmd"), DIAGNOSTICS)
    driver = Late(lambda: iter([frame(1)]))
    config = DriverConfig(bus=bus.config, kind="pmd", name="pmd", retry_s=0.05, max_retry_s=0.05)
    with hosted(driver, config):
        receiver.until(lambda messages: len(messages["pmd/depth/image_raw"]) == 1)
    assert (driver.opened, driver.closed) == (3, 1)


def test_a_silent_sensor_is_an_error_and_connected_again(bus):
    receiver = Receiver(bus.node("receiver"), DIAGNOSTICS)
    driver = Scripted(silent)
    with hosted(driver, DriverConfig(bus=bus.config, kind="pmd", name="pmd", silence_s=0.1, retry_s=0.1)):
        told = receiver.diagnostic(lambda item: int(item.values.get("failures/pmd", 0)) >= 2)
    assert told.level is Health.ERROR
    assert "no frame for" in told.message
    assert driver.opened == driver.closed >= 2


class Pausing(Scripted):
    """A player whose two frames are half a second apart."""

    due = 0.0

    def frames(self):
        yield frame(1)
        pause, self.due = Event(), monotonic() + 0.5
        while monotonic() < self.due:
            pause.wait(0.02)
            yield None
        yield frame(2)
        if self.opened == 1:
            yield from silent()

    def due_s(self):
        return self.due


def test_an_announced_pause_is_no_silence_but_what_does_not_come_after_it_is(bus):
    receiver = Receiver(bus.node("receiver"), DEPTH.of("pmd"), DIAGNOSTICS)
    driver = Pausing()
    config = DriverConfig(bus=bus.config, kind="pmd", name="pmd", silence_s=0.2, retry_s=0.1)
    with hosted(driver, config):
        receiver.until(lambda got: len(got["pmd/depth/image_raw"]) == 4)
        told = receiver.diagnostic(lambda item: item.message == "the source has ended")
    assert (driver.opened, told.values["failures/pmd"]) == (2, "1")


def test_a_driver_that_is_stopped_while_it_opens_its_device_ends_without_an_error(bus, caplog):
    opening = Event()

    class Slow(Scripted):
        def take_stop(self, stop):
            self.stop = stop

        def connect(self):
            opening.set()
            assert self.stop.wait(TIMEOUT_S)
            raise StoppedError("pmd")

    config = DriverConfig(bus=bus.config, kind="pmd", name="pmd", retry_s=30.0)
    with hosted(Slow(silent), config):
        assert opening.wait(TIMEOUT_S)
    assert not [each for each in caplog.records if each.levelname == "ERROR"]


def test_a_driver_that_hangs_in_its_device_is_told(bus):
    release = Event()

    def hangs() -> Iterator[PmdFrame]:
        yield frame(1)
        assert release.wait(TIMEOUT_S)

    receiver = Receiver(bus.node("receiver"), DIAGNOSTICS)
    with hosted(Scripted(hangs), DriverConfig(bus=bus.config, kind="pmd", name="pmd", silence_s=0.2)):
        told = receiver.diagnostic(lambda item: "no frame for" in item.message)
        release.set()
    assert told.level is Health.ERROR
    assert float(told.values["last_frame_age_s"]) > 0.2
    assert (told.values["sync/pmd/ptp"], told.values["sync/pmd/trigger"]) == ("locked", "hardware")


def test_a_frame_that_cannot_be_published_is_counted_and_the_next_one_is(bus):
    bad = frame(1, amplitude=np.ones((3, 4), np.float64))
    receiver = Receiver(bus.node("receiver"), DEPTH.of("pmd"), DIAGNOSTICS)
    with hosted(
        Scripted(lambda: iter([bad, frame(2)])), DriverConfig(bus=bus.config, kind="pmd", name="pmd")
    ):
        messages = receiver.until(lambda messages: len(messages["pmd/depth/image_raw"]) == 1)
        receiver.diagnostic(lambda item: item.values.get("rejected/pmd/wrong_type") == "1")
    assert read_depth(messages["pmd/depth/image_raw"][0])[0, 0] == 2.0


@pytest.mark.parametrize("organised", [True, False])
def test_a_lidar_delivers_scans_and_its_pattern(bus, organised):
    info = LidarInfo(
        azimuth_rad=np.arange(3.0), elevation_rad=np.arange(2.0), scan_time_s=0.5, sigma_range_m=0.01
    )
    points_m = np.arange(18, dtype=np.float32).reshape((2, 3, 3) if organised else (6, 3))
    intensity = points_m[..., 0] + 100
    scan = LidarScan(
        stamp_ns=STAMP_NS, frame_id="", points_m=points_m, intensity=intensity, time_s=intensity * 0.001
    )
    receiver = Receiver(bus.node("receiver"), POINTS.of("front"), LIDAR_INFO.of("front"), TF_STATIC)
    with hosted(
        Scripted(lambda: iter([scan]), info=info), DriverConfig(bus=bus.config, kind="lidar", name="front")
    ):
        messages = receiver.until(lambda messages: all(messages.values()))
    fields = read_points(messages["front/points"][0])
    assert np.array_equal(np.stack([fields[name] for name in "xyz"], axis=-1), points_m)
    assert np.array_equal(fields["intensity"], intensity)
    assert np.array_equal(fields["t"], scan.time_s)
    assert read_stamp(messages["front/points"][0].header) == STAMP_NS
    assert read_lidar_info(messages["front/info"][0]).azimuth_rad.tolist() == [0.0, 1.0, 2.0]
    assert read_transforms(messages["tf_static"][0])[0][1:3] == ("chaser", "front")


class Adjusted(Scripted):
    """A camera that forgets its settings with each connection, and takes a frame only when triggered."""

    def __init__(self) -> None:
        super().__init__(self.triggered)
        self.device: dict[str, object] = {}
        self.answers, self.broken, self.pulses = True, Event(), 0

    def connect(self):
        self.device = {"exposure_us": 1000, "mode": "near"}
        return super().connect()

    def settings(self):
        return self.device

    def apply(self, settings):
        if unknown := settings.keys() - self.device.keys():
            raise DriverError(f"no setting {unknown.pop()!r}")
        if settings.get("exposure_us", 0) > 2000:
            raise DriverError(f"exposure_us is {settings['exposure_us']}, at most 2000")
        self.device |= settings

    def trigger(self):
        self.pulses += self.answers

    def drops(self):
        return Drops(device=3, queue=1)

    def triggered(self):
        pause, number = Event(), 0
        while not self.broken.is_set():
            pause.wait(0.01)
            if self.pulses:
                self.pulses, number = self.pulses - 1, number + 1
                yield frame(number)
            else:
                yield None
        self.broken.clear()
        raise OSError("the cable is out")


def test_settings_are_written_while_it_runs_and_again_after_a_reconnection(bus):
    node = bus.node("operator")
    receiver = Receiver(bus.node("receiver"), DIAGNOSTICS)
    driver = Adjusted()
    config = DriverConfig(bus=bus.config, kind="pmd", name="pmd", retry_s=0.05, settings={"exposure_us": 500})
    with hosted(driver, config):
        told = receiver.diagnostic(lambda item: item.values.get("lost/pmd/device") == "3")
        assert told.values["lost/pmd/queue"] == "1"
        asked = node.ask("driver", "settings", SettingsReply, SettingsRequest(settings={"mode": "far"}))
        assert asked.settings == {"exposure_us": 500, "mode": "far"}
        with pytest.raises(QueryFailedError, match="no setting 'gain'"):
            node.ask("driver", "settings", SettingsReply, SettingsRequest(settings={"gain": 2.0}))
        driver.broken.set()
        receiver.diagnostic(lambda item: item.values.get("failures/pmd") == "1")
        asked = node.ask("driver", "settings", SettingsReply)
    assert driver.opened == 2
    assert asked.settings == {"exposure_us": 500, "mode": "far"}


def test_settings_are_parameters_that_ros_2_tools_set_while_it_runs(bus, endpoint):
    node = bus.node("operator")
    driver = Adjusted()
    config = DriverConfig(bus=bus.config, kind="pmd", name="pmd", retry_s=0.05)
    with hosted(driver, config), RosClient(endpoint) as client:
        changed = SettingsRequest(settings={"mode": "far"})
        assert node.ask("driver", "settings", SettingsReply, changed).settings["mode"] == "far"
        wanted = [
            assignment("settings.exposure_us", type=2, integer_value=700),
            assignment("settings.exposure_us", type=2, integer_value=9000),
            assignment("settings.exposure_us", type=4, string_value="long"),
        ]
        results = parameters(client, "driver", "set_parameters", parameters=wanted).results
        assert [each.successful for each in results] == [True, False, False]
        assert "at most 2000" in results[1].reason
        assert "of type integer" in results[2].reason
        assert driver.device == {"exposure_us": 700, "mode": "far"}
        names = ["settings.exposure_us", "settings.mode"]
        exposure, mode = parameters(client, "driver", "get_parameters", names=names).values
        assert (exposure.integer_value, mode.string_value) == (700, "far")
        driver.broken.set()
        until(lambda: driver.opened == 2)
        assert node.ask("driver", "settings", SettingsReply).settings == {"exposure_us": 700, "mode": "far"}


def test_a_trigger_gives_one_frame_and_one_without_a_frame_is_counted(bus):
    node = bus.node("operator")
    receiver = Receiver(bus.node("receiver"), DIAGNOSTICS, DEPTH.of("pmd"))
    driver = Adjusted()
    with hosted(driver, DriverConfig(bus=bus.config, kind="pmd", name="pmd", trigger_timeout_s=0.1)):
        assert node.ask("driver", "trigger", Accepted).accepted
        receiver.until(lambda messages: len(messages["pmd/depth/image_raw"]) == 1)
        driver.answers = False
        assert node.ask("driver", "trigger", Accepted).accepted
        receiver.diagnostic(lambda item: item.values.get("sync/pmd/trigger_missed") in ("1", "2"))


def test_a_driver_without_settings_says_so(bus):
    node = bus.node("operator")
    with (
        hosted(Scripted(silent), DriverConfig(bus=bus.config, kind="pmd", name="pmd")),
        pytest.raises(QueryFailedError, match="it needs the methods settings and apply"),
    ):
        node.ask("driver", "settings", SettingsReply, SettingsRequest(settings={"gain": 2.0}))


def test_a_driver_of_the_wrong_kind_is_told(bus):
    receiver = Receiver(bus.node("receiver"), DIAGNOSTICS)
    with hosted(
        Scripted(lambda: iter([frame(1)])),
        DriverConfig(bus=bus.config, kind="lidar", name="pmd", retry_s=0.3),
    ):
        told = receiver.diagnostic(lambda item: "PmdFrame" in item.message)
    assert told.level is Health.ERROR


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"depth_m": np.ones((3, 4))}, "PmdFrame: depth_m: is of float64, needs an array of float32"),
        ({"stamp_ns": 1.5}, "PmdFrame: stamp_ns: Input should be a valid integer"),
    ],
)
def test_fields_that_a_copy_of_a_frame_took_unchecked_are_refused_by_their_names(bus, changes, told):
    receiver = Receiver(bus.node("receiver"), DEPTH.of("pmd"), DIAGNOSTICS)
    bad = frame(1).model_copy(update=changes)
    with hosted(
        Scripted(lambda: iter([bad])), DriverConfig(bus=bus.config, kind="pmd", name="pmd", retry_s=0.3)
    ):
        receiver.diagnostic(lambda item: item.message.startswith(told))
    assert not receiver.messages["pmd/depth/image_raw"]
