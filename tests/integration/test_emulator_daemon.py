"""The emulator's daemon on a real bus: truth in, frames out, faults on request."""

import time
from time import monotonic

import numpy as np
import pytest
from live_bus import TIMEOUT_S, daemon, first
from ros_client import RosClient

from rpod_emulator.daemon import run
from rpod_motion.daemon import run as run_motion
from rpod_runtime import Inbox, QueryFailedError
from rpod_schemas.config.emulator import EmulatorConfig, LockstepConfig, MotionServiceConfig
from rpod_schemas.config.lidar import LidarConfig, ScanPatternConfig
from rpod_schemas.config.motion import MotionConfig
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.control import Accepted, FaultRequest, StartRequest, StatusReply
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.messages import (
    NANOSECONDS,
    read_camera,
    read_depth,
    read_lidar_info,
    read_pmd_info,
    read_points,
    read_stamp,
    read_transforms,
    write_status,
)
from rpod_schemas.poses import make_pose
from rpod_schemas.schedule import lockstep_steps
from rpod_schemas.topics import (
    CAMERA_INFO,
    DEPTH,
    DIAGNOSTICS,
    LIDAR_INFO,
    PMD_INFO,
    POINTS,
    STATUS,
    TF_STATIC,
)
from rpod_schemas.types import EstimatorStatus, Mode
from rpod_target import load_target

PMD = PmdConfig(rate_hz=10.0, T_chaser_sensor=make_pose(translation_m=[0.0, -0.05, 0.0]))
LIDAR = LidarConfig(
    pattern=ScanPatternConfig(azimuth_span_deg=20.0, elevation_span_deg=20.0, step_deg=2.0), rate_hz=2.0
)
EPOCH_NS = 1_767_225_600 * NANOSECONDS


class Viewer:
    """Hears topics of the sensors, each in an inbox of its own."""

    def __init__(self, bus) -> None:
        self.node = bus.node("viewer")
        self.inboxes = {}
        self.hear(DIAGNOSTICS)

    def hear(self, *topics) -> None:
        for topic in topics:
            self.inboxes[topic.name] = Inbox()
            self.node.subscribe(topic, self.inboxes[topic.name].put, recover=True)

    def next(self, topic, read):
        return first(self.inboxes[topic.name], lambda received: read(received.decode()))

    def ready(self, *instances: str) -> None:
        """Wait until services say that they are; their heartbeats set the pace of asking."""
        deadline_s = monotonic() + 120.0
        for instance in instances:
            while self._state(instance) != "ready":
                assert monotonic() < deadline_s, f"{instance} is not ready"
                self.inboxes[DIAGNOSTICS.name].wait(0.1)

    def _state(self, instance: str) -> str:
        try:
            return self.node.ask(instance, "status", StatusReply, timeout_s=TIMEOUT_S).state
        except QueryFailedError:
            return "absent"


def facility(bus, *sensors, speed="1", duration_s=5.0, **motion):
    emulator = EmulatorConfig(
        target="mockup",
        bus=bus.config,
        sensors=sensors,
        seed=3,
        await_start=True,
        time_source="clock" if speed == "max" else "wall",
    )
    truth = MotionServiceConfig(
        target="mockup",
        bus=bus.config,
        motion=MotionConfig(),
        duration_s=duration_s,
        sensors=sensors,
        await_start=True,
        speed=speed,
        **motion,
    )
    return emulator, truth


def start(viewer: Viewer, epoch_ns: int) -> None:
    for instance in ("emulator", "motion"):
        assert viewer.node.ask(
            instance, "start", Accepted, StartRequest(epoch_ns=epoch_ns), timeout_s=TIMEOUT_S
        ).accepted


def test_truth_becomes_frames_of_every_sensor(bus):
    viewer = Viewer(bus)
    viewer.hear(
        TF_STATIC, PMD_INFO.of("pmd"), LIDAR_INFO.of("lidar"), DEPTH.of("pmd"), CAMERA_INFO.of("pmd"),
        POINTS.of("lidar"),
    )  # fmt: skip
    emulator, motion = facility(bus, PMD, LIDAR)
    with daemon(run, emulator), daemon(run_motion, motion):
        viewer.ready("emulator", "motion")
        epoch_ns = time.time_ns() + NANOSECONDS // 2
        start(viewer, epoch_ns)

        depth = viewer.next(DEPTH.of("pmd"), lambda message: message)
        number = round((read_stamp(depth.header) - epoch_ns) * PMD.rate_hz / NANOSECONDS)
        assert number >= 1
        assert read_stamp(depth.header) == epoch_ns + number * NANOSECONDS // 10
        assert 5.0 < np.nanmedian(read_depth(depth)) < 8.0
        assert viewer.next(CAMERA_INFO.of("pmd"), read_camera).width == PMD.camera.width
        cloud = viewer.next(POINTS.of("lidar"), read_points)
        assert cloud["z"].shape == (11, 11)
        assert viewer.next(PMD_INFO.of("pmd"), read_pmd_info).saturation_count > 0
        assert viewer.next(LIDAR_INFO.of("lidar"), read_lidar_info).azimuth_rad.size == 11
        mounts = {}
        assert first(
            viewer.inboxes[TF_STATIC.name],
            lambda received: (
                mounts.update({item[2]: item for item in read_transforms(received.decode())})
                or len(mounts) == 2
            ),
        )
        assert set(mounts) == {"pmd_optical", "lidar"}
        np.testing.assert_allclose(mounts["pmd_optical"][3].translation, [0.0, -0.05, 0.0])

        assert viewer.node.ask(
            "emulator",
            "fault",
            Accepted,
            FaultRequest(fault="blackout", duration_s=60.0),
            timeout_s=TIMEOUT_S,
        ).accepted
        assert viewer.next(
            DEPTH.of("pmd"), lambda message: not np.isfinite(message.data.view(np.float32)).any()
        )
        status = viewer.node.ask("emulator", "status", StatusReply, timeout_s=TIMEOUT_S)
        assert status.counters["frames/pmd"] >= 2
        assert status.target_digest == load_target("mockup").digest
        with pytest.raises(QueryFailedError, match="already started"):
            viewer.node.ask("motion", "start", Accepted, StartRequest(epoch_ns=epoch_ns))


def test_in_lockstep_every_frame_is_made_and_waited_for_and_comes_out_the_same_twice(bus):
    """The test stands for estimator and logger: it answers each frame with a status."""
    viewer, answers = Viewer(bus), bus.node("stand_in").publisher(STATUS)
    viewer.hear(DEPTH.of("pmd"), POINTS.of("lidar"))
    payloads = []
    for _ in range(2):
        emulator, motion = facility(
            bus, PMD, LIDAR, speed="max", duration_s=1.0, lockstep=LockstepConfig(logger=None)
        )
        with daemon(run, emulator), daemon(run_motion, motion):
            viewer.ready("emulator", "motion")
            start(viewer, EPOCH_NS)
            for step in lockstep_steps((PMD, LIDAR), epoch_ns=EPOCH_NS, duration_s=1.0):
                frame = step.frame
                topic = DEPTH.of("pmd") if frame.sensor == "pmd" else POINTS.of("lidar")
                message = viewer.next(topic, lambda message: message)
                assert message is not None, f"{frame} does not come"
                assert read_stamp(message.header) == frame.stamp_ns
                payloads.append(bytes(message.data))
                answers.publish(
                    write_status(
                        EstimatorStatus(
                            stamp_ns=frame.stamp_ns, frame_id="chaser", mode=Mode.LOST, sensor=frame.sensor
                        )
                    )
                )
            assert (
                viewer.node.ask("emulator", "status", StatusReply, timeout_s=TIMEOUT_S).counters["frames/pmd"]
                == 10
            )
    half = len(payloads) // 2
    assert half == 12
    assert payloads[:half] == payloads[half:]


def test_a_lens_that_no_camera_has_is_refused_by_the_sensors_name(bus):
    folded = PMD.camera.model_copy(update={"distortion": np.array([-9.0, 0.0, 0.0, 0.0, 0.0])})
    emulator, _ = facility(bus, PMD.model_copy(update={"camera": folded}))
    with pytest.raises(ConfigurationError, match=r"sensors\.pmd: "), daemon(run, emulator) as stop:
        stop.wait(30.0)


def test_facility_is_started_by_calls_of_ros_services_without_an_epoch(bus, endpoint):
    viewer = Viewer(bus)
    viewer.hear(DEPTH.of("pmd"))
    emulator, motion = facility(bus, PMD)
    with daemon(run, emulator), daemon(run_motion, motion), RosClient(endpoint) as client:
        viewer.ready("emulator", "motion")
        called_ns = time.time_ns()
        assert client.call("/emulator/start", "std_srvs/srv/Trigger").success
        assert client.call("/motion/start", "std_srvs/srv/Trigger").success
        depth = viewer.next(DEPTH.of("pmd"), lambda message: message)
        assert called_ns < read_stamp(depth.header) < called_ns + 20 * NANOSECONDS
        again = client.call("/motion/start", "std_srvs/srv/Trigger")
    assert not again.success
    assert "plays once" in again.message


def test_lockstep_is_not_started_without_an_epoch(bus, endpoint):
    viewer = Viewer(bus)
    emulator, _ = facility(bus, PMD, speed="max")
    with daemon(run, emulator), RosClient(endpoint) as client:
        viewer.ready("emulator")
        response = client.call("/emulator/start", "std_srvs/srv/Trigger")
    assert not response.success
    assert "ask for a start with epoch_ns" in response.message
