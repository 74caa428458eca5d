"""The estimator's daemon on a real bus: from first frame to LOST and back, and what it says of itself."""

import signal
import subprocess
import sys
import time
from threading import Event
from time import monotonic

import numpy as np
import pytest
from live_bus import TIMEOUT_S, daemon, first
from pmd_frames import frame_of
from scipy.spatial.transform import Rotation

from rpod_estimator.daemon import run
from rpod_runtime import Inbox, Node
from rpod_runtime.errors import AlreadyRunningError
from rpod_runtime.sensors import CameraPublisher
from rpod_schemas.config.estimator import EstimatorConfig, NavigatorConfig, PmdInput
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.config.service import ServiceConfig
from rpod_schemas.control import Accepted, Empty, ResetRequest, StatusReply
from rpod_schemas.messages import read_diagnostics, read_odometry, read_status, read_transforms
from rpod_schemas.poses import make_pose
from rpod_schemas.topics import DEPTH, DIAGNOSTICS, ESTIMATE, STATUS, TF
from rpod_schemas.types import Camera, Health, Mode
from rpod_sim_sensor.pmd import PmdEmulator
from rpod_target import load_target

CAMERA = Camera(width=88, height=72, fx=170.0, fy=170.0, cx=43.5, cy=35.5)
"""Small, so that no frame is dropped by a bus that is short of processor time."""
MOUNT = make_pose(translation_m=[0.0, -0.05, 0.0])
T_CHASER_TARGET = make_pose(
    rotation=Rotation.from_euler("ZYX", [12.0, 65.0, 5.0], degrees=True), translation_m=[0.05, 0.0, 4.0]
)


class Sensor:
    """Publishes the same good view whenever it is asked to."""

    def __init__(self, bus, node=None, mount=MOUNT) -> None:
        self._publisher = CameraPublisher(node or bus.node("camera"), "pmd", T_chaser_sensor=mount)
        emulator = PmdEmulator(PmdConfig(camera=CAMERA), load_target("mockup"), seed=1)
        poses = [MOUNT.inv() * T_CHASER_TARGET] * 4
        exposure = emulator.expose(poses, sun_W_m2=np.zeros(3), frame=1)
        self._exposed = 0
        self._frame = frame_of(exposure.depth_m.copy(), amplitude=exposure.amplitude.copy(), camera=CAMERA)

    def expose(self, *, late_s: float = 0.0) -> int:
        stamp_ns = time.time_ns() + round(late_s * 1e9)
        self._exposed += 1
        depth_m = self._frame.depth_m * np.float32(1.0 + 1e-6 * self._exposed)  # noise never repeats
        self._publisher.publish(self._frame.model_copy(update={"stamp_ns": stamp_ns, "depth_m": depth_m}))
        return stamp_ns


class Listener:
    """What an estimator says, by topic."""

    def __init__(self, bus, prefix: str = "estimate") -> None:
        self.node = bus.node(f"listener_of_{prefix}")
        self.statuses, self.odometry, self.health, self.tf = Inbox(), Inbox(), Inbox(), Inbox()
        self.node.subscribe(STATUS.under(prefix), self.statuses.put, recover=True)
        self.node.subscribe(ESTIMATE.under(prefix), self.odometry.put, recover=True)
        self.node.subscribe(DIAGNOSTICS, self.health.put, recover=True)
        self.node.subscribe(TF, self.tf.put, recover=True)

    def counters(self) -> dict[str, int]:
        return self.node.ask("estimator", "status", StatusReply, timeout_s=TIMEOUT_S).counters

    def status(self, fits):
        def pick(received):
            status = read_status(received.decode())
            return status if fits(status) else None

        return first(self.statuses, pick)


def config(bus, **changes) -> EstimatorConfig:
    return EstimatorConfig(target="mockup", bus=bus.config, sensors=(PmdInput(),), **changes)


def frames_until(camera: Sensor, listener: Listener, mode: Mode):
    """Expose frame after frame, each upon the status of the one before, until the mode is reached."""
    deadline_s = monotonic() + TIMEOUT_S
    while monotonic() < deadline_s:  # a search takes as long as many frames
        stamp_ns = camera.expose()
        status = listener_status(listener, stamp_ns)
        if status is not None and status.mode == mode:
            return status
    raise AssertionError(f"never {mode.name}")


def listener_status(listener: Listener, stamp_ns: int):
    def pick(received):
        status = read_status(received.decode())
        return status if status.stamp_ns >= stamp_ns else None

    return first(listener.statuses, pick, 2.0)


def test_a_target_is_found_tracked_lost_in_silence_and_found_again(bus):
    listener, camera = Listener(bus), Sensor(bus)
    with daemon(run, config(bus, navigator=NavigatorConfig(silence_timeout_s=0.5))):
        frames_until(camera, listener, Mode.TRACKING)
        odometry = first(listener.odometry, lambda received: read_odometry(received.decode()))
        assert (odometry.frame_id, odometry.child_frame_id) == ("chaser", "target_estimate")
        np.testing.assert_allclose(odometry.pose.translation, T_CHASER_TARGET.translation, atol=0.05)
        ((_, parent, child, pose),) = first(listener.tf, lambda received: read_transforms(received.decode()))
        assert (parent, child) == ("chaser", "target_estimate")
        np.testing.assert_allclose(pose.translation, T_CHASER_TARGET.translation, atol=0.05)

        lost = listener.status(lambda status: status.mode == Mode.LOST)
        assert lost.reason.startswith("no measurement was accepted for")
        warned = first(
            listener.health,
            lambda received: [
                item
                for item in read_diagnostics(received.decode())
                if (item.name, item.level, item.message[:4]) == ("estimator", Health.WARN, "lost")
            ],
        )
        assert warned
        frames_until(camera, listener, Mode.TRACKING)


def test_frames_that_cannot_be_used_do_not_hide_that_the_target_is_lost(bus):
    """A stream of late frames is as good as silence."""
    listener, camera = Listener(bus), Sensor(bus)
    settings = NavigatorConfig(silence_timeout_s=0.5)
    with daemon(run, config(bus, initial_pose=T_CHASER_TARGET, navigator=settings)):
        frames_until(camera, listener, Mode.TRACKING)
        deadline_s, status = monotonic() + TIMEOUT_S, None
        while (status is None or status.mode != Mode.LOST) and monotonic() < deadline_s:
            camera._publisher.publish(camera._frame.model_copy(update={"stamp_ns": time.time_ns() - 10**10}))
            status = listener.status(lambda _: True)
        assert status.mode == Mode.LOST


def told_by_estimator(listener, fits):
    """Return the estimator's first diagnostic that fits."""

    def pick(received):
        return next(
            (item for item in read_diagnostics(received.decode()) if item.name == "estimator" and fits(item)),
            None,
        )

    return first(listener.health, pick)


def exposed_until_told(camera, listener, words, *, stamp_late_s=0.0):
    """Expose frames in the time that they take, with late stamps, until the diagnostics have these words."""
    deadline_s, pause = monotonic() + TIMEOUT_S, Event()
    while monotonic() < deadline_s:
        camera.expose(late_s=stamp_late_s)
        pause.wait(0.1)
        for received in listener.health.wait(0.0):
            for item in read_diagnostics(received.decode()):
                if item.name == "estimator" and words in item.message:
                    return item
    raise AssertionError(f"never told: {words}")


def test_depth_in_centimetres_is_told_as_another_unit_with_the_field_to_set(bus):
    listener, camera = Listener(bus), Sensor(bus)
    camera._frame = camera._frame.model_copy(update={"depth_m": camera._frame.depth_m * np.float32(100.0)})
    with daemon(run, config(bus)):
        told = exposed_until_told(camera, listener, "the depth is in another unit")
    assert told.level == Health.ERROR
    assert "set source.depth_unit_m of the sensor" in told.message


def test_stamps_that_are_late_within_the_limit_are_told_although_the_frames_are_used(bus):
    listener, camera = Listener(bus), Sensor(bus)
    with daemon(run, config(bus, initial_pose=T_CHASER_TARGET)):
        told = exposed_until_told(camera, listener, "frames arrive before their stamp", stamp_late_s=0.045)
    assert told.level == Health.WARN
    assert float(told.values["arrives_after_s/pmd"]) < -0.008
    assert int(told.values["inputs/pmd/used"]) > 0


def poses(listener):
    """Return the poses that were estimated since the last call."""
    found = [read_odometry(received.decode()).pose for received in listener.odometry.wait(TIMEOUT_S)]
    assert found
    return found


def test_a_second_camera_is_told_of_and_not_used_until_the_first_is_gone_and_a_reset_accepts_its_mount(bus):
    listener = Listener(bus)
    elsewhere = make_pose(translation_m=[0.0, -0.05, 1.0])
    first_node = Node(ServiceConfig(instance="first_camera", bus=bus.config), version="test", stop=Event())
    with daemon(run, config(bus, initial_pose=T_CHASER_TARGET)):
        with first_node:
            camera = Sensor(bus, first_node)
            frames_until(camera, listener, Mode.TRACKING)
            other = Sensor(bus, mount=elsewhere)
            other.expose()
            frames_until(camera, listener, Mode.TRACKING)
            depth = "publishers/pmd/depth/image_raw"
            told = told_by_estimator(listener, lambda item: depth in item.values)
            assert (told.level, told.values[depth].count("session")) == (Health.WARN, 2)
            assert "two publishers on pmd/" in told.message
        stamp_ns = other.expose()
        refused = listener_status(listener, stamp_ns)
        assert "other_setup: the mount has moved by 1.000 m" in refused.reason
        told = told_by_estimator(listener, lambda item: "the mount has moved by 1.000 m" in item.message)
        assert told.level == Health.ERROR
        for pose in poses(listener):
            np.testing.assert_allclose(pose.translation, T_CHASER_TARGET.translation, atol=0.05)
        gid = refused.reason.partition("frames of ")[2][:32]
        there = elsewhere * MOUNT.inv() * T_CHASER_TARGET
        request = ResetRequest(pose=there, keep_gid=gid)
        assert listener.node.ask("estimator", "reset", Accepted, request, timeout_s=TIMEOUT_S).accepted
        frames_until(other, listener, Mode.TRACKING)
        for pose in poses(listener):
            np.testing.assert_allclose(pose.translation, there.translation, atol=0.05)


def test_two_estimators_run_side_by_side(bus):
    listeners, camera = [Listener(bus), Listener(bus, "second")], Sensor(bus)
    one = config(bus, initial_pose=T_CHASER_TARGET)
    two = config(
        bus, initial_pose=T_CHASER_TARGET, prefix="second", instance="estimator2", zenoh_id="e57a7e2"
    )
    with daemon(run, one), daemon(run, two):
        for listener in listeners:
            frames_until(camera, listener, Mode.TRACKING)
            assert first(listener.odometry, lambda received: read_odometry(received.decode()))


def test_a_second_estimator_of_the_name_does_not_start_and_one_with_the_same_topics_is_told_by_both(bus):
    listener = Listener(bus)
    with daemon(run, config(bus, zenoh_id="e57a7e")):
        assert told_by_estimator(listener, lambda item: item.level == Health.OK)
        with pytest.raises(AlreadyRunningError, match="another 'estimator' is at work on this bus"):
            run(config(bus, zenoh_id="e57a7e"), version="test", stop=Event())
        with daemon(run, config(bus, zenoh_id="e57a7e", instance="other")):
            for name in ("estimator", "other"):
                told = first(
                    listener.health,
                    lambda received, name=name: [
                        item
                        for item in read_diagnostics(received.decode())
                        if item.name == name and "second_service" in item.values
                    ],
                )
                assert told, f"{name} says nothing"
                text = told[0].values["second_service"]
                assert "another service publishes estimate/status (session e57a7e" in text
                assert "stop one of them, or give one another instance and prefix" in text
                assert told[0].level == Health.WARN
        assert told_by_estimator(listener, lambda item: "second_service" not in item.values)
    with daemon(run, config(bus, zenoh_id="e57a7e")):  # a successor starts
        assert told_by_estimator(listener, lambda item: item.level == Health.OK)


def test_a_driver_in_another_ros_domain_is_told_with_its_domain(bus):
    listener, elsewhere = Listener(bus), bus.config.model_copy(update={"domain": 7})
    other = ServiceConfig(instance="driver", bus=elsewhere)
    with Node(other, version="test", stop=Event()) as driver, daemon(run, config(bus)):
        driver.publisher(DEPTH.of("front"))
        told = told_by_estimator(listener, lambda item: "ROS domain" in item.message)
    assert "/front/depth/image_raw is published in ROS domain 7: give driver and estimator" in told.message


def test_what_is_passed_over_is_counted_and_has_no_status(bus):
    listener, camera = Listener(bus), Sensor(bus)
    with daemon(run, config(bus, initial_pose=T_CHASER_TARGET)):
        frames_until(camera, listener, Mode.TRACKING)
        before = listener.counters()
        sent = [camera.expose() for _ in range(40)]
        processed = []

        def is_last(received) -> bool:
            processed.append(read_status(received.decode()).stamp_ns)
            return processed[-1] == sent[-1]

        for _ in range(
            20
        ):  # the bus may miss the last of a burst; the newest that arrives is never passed over
            if first(listener.statuses, is_last, timeout_s=1.0):
                break
            sent.append(camera.expose())
        assert processed[-1] == sent[-1]
        after = listener.counters()
        gained = {name: count - before.get(name, 0) for name, count in after.items()}
        passed_over = gained["dropped/pmd"] + gained.get("incomplete/pmd", 0)
        missed = sum(count for name, count in gained.items() if name.startswith("missed/pmd"))
        assert len(sent) - missed <= len(processed) + passed_over <= len(sent)
        assert processed == sorted(processed)
        assert "received/truth/odometry" not in after


def test_the_daemon_ends_when_it_is_told_to_over_the_bus(bus):
    listener = Listener(bus)
    with daemon(run, config(bus)) as stop:
        ready = first(
            listener.health,
            lambda received: [
                item
                for item in read_diagnostics(received.decode())
                if item.name == "estimator" and item.message != "starting"
            ],
            120.0,
        )
        assert ready
        status = listener.node.ask("estimator", "status", StatusReply, timeout_s=TIMEOUT_S)
        assert status.target_digest == load_target("mockup").digest
        assert status.configuration["sensors"][0]["kind"] == "pmd"
        assert listener.node.ask("estimator", "shutdown", Accepted, Empty(), timeout_s=TIMEOUT_S).accepted
        assert stop.wait(TIMEOUT_S)


def test_a_process_that_is_told_to_stop_ends_well_and_does_not_hang(bus, tmp_path):
    listener = Listener(bus)
    file = tmp_path / "estimator.json"
    file.write_text(config(bus).model_dump_json(), "utf-8")
    process = subprocess.Popen(
        [sys.executable, "-m", "rpod", "estimator", "--config", file],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert first(
            listener.health,
            lambda received: [
                item for item in read_diagnostics(received.decode()) if item.name == "estimator"
            ],
            120.0,
        )
        process.send_signal(signal.SIGTERM)
        stdout, stderr = process.communicate(timeout=TIMEOUT_S)
    finally:
        process.kill()
    assert process.returncode == 0, stderr
    assert stdout == ""
    assert "stopped" in stderr.splitlines()[-1]
