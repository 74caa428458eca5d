"""Sensors for the check, without a bus and without waiting: messages under virtual time.

``Desk`` stands for the bus: it numbers, delays and loses messages, and hands them to an observer.
Sensors are emulated here in a few lines of their own, so that the check is not tested on the facility's
emulator alone.
"""

import heapq
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from itertools import count
from typing import Any

import numpy as np
from pmd_frames import depth_frame
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_driver.check import CheckResult, Observations, Observer, Options, judge
from rpod_driver.check.surface import Surface
from rpod_runtime import Received
from rpod_runtime.sensors import CameraPublisher, LidarPublisher
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.motion import FACING
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.messages import write_odometry, write_status
from rpod_schemas.poses import chained, make_pose, rotation_of
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.rmw.wire import Attachment
from rpod_schemas.topics import ESTIMATE, STATUS, TRUTH, Topic
from rpod_schemas.types import (
    Camera,
    LidarInfo,
    LidarScan,
    Odometry,
    PmdFrame,
    PmdInfo,
)
from rpod_sim_sensor.faults import Injection, Outgoing, injection, parts_of
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_sim_sensor.pmd import PmdEmulator
from rpod_target import load_target

EPOCH_NS = 1_767_225_600_000_000_000
SECOND_NS = 1_000_000_000
MOUNT = make_pose(translation_m=(0.02, -0.05, 0.1))


class Desk:
    """Node and bus at once, for one sensor."""

    def __init__(
        self,
        kind: str,
        name: str,
        *,
        faults: tuple[str, ...] = (),
        seed: int = 0,
        options: Options | None = None,
    ) -> None:
        self.observer = Observer(kind, name, options)
        self.injections: list[Injection] = [injection(fault, kind, seed) for fault in faults]
        self._parts = parts_of(kind, name)
        self._random = np.random.default_rng([seed, 0xDE5C])
        self._sequences: dict[tuple[str, str], int] = defaultdict(int)
        self._waiting: list[tuple[int, int, Received]] = []
        self._order = count()
        self.now = EPOCH_NS

    @property
    def clock(self) -> "Desk":
        return self

    def now_ns(self) -> int:
        return self.now

    def publisher(self, topic: Topic) -> "DeskPublisher":
        return DeskPublisher(self, topic)

    def put(self, topic: Topic, message: Any) -> None:
        several = [Outgoing(topic, self._parts.get(topic.name, "extra"), message)]
        for each in self.injections:
            several = [made for one in several for made in each.apply(one)]
        for made in several:
            self._send(made)

    def _send(self, made: Outgoing) -> None:
        place = made.topic.name, made.publisher
        self._sequences[place] += 1
        token = made.topic.name, made.topic.offered.token(), made.publisher or "own"
        self.observer.take_tokens([token])
        if made.lost:
            return
        gid = f"{made.topic.name}{made.publisher}".encode()[-16:].rjust(16)
        wait_ns = round(made.delay_s * SECOND_NS) + round(self._random.gamma(2.0, 4e5))
        attachment = Attachment(self._sequences[place], self.now, gid)
        payload = memoryview(bytes(encode(made.message)))
        arrival_ns = self.now + wait_ns
        received = Received(made.topic, "", payload, attachment, arrival_ns, session=made.publisher or "own")
        heapq.heappush(self._waiting, (arrival_ns, next(self._order), received))

    def deliver(self, until_ns: int) -> None:
        """Hand over what has arrived by a time."""
        self.now = until_ns
        while self._waiting and self._waiting[0][0] <= until_ns:
            self.observer.take(heapq.heappop(self._waiting)[2])

    def end(self) -> Observations:
        self.deliver(self.now + 5 * SECOND_NS)
        return self.observer.end(self.now)


class DeskPublisher:
    def __init__(self, desk: Desk, topic: Topic) -> None:
        self._desk, self._topic = desk, topic

    def publish(self, message: Any) -> None:
        self._desk.put(self._topic, message)


CAMERA = Camera(width=40, height=30, fx=31.0, fy=31.0, cx=19.7, cy=14.4)
INFO = PmdInfo(
    modulation_frequency_hz=np.array([2e7]),
    integration_time_s=8e-3,
    electrons_per_count=9.0,
    saturation_count=4095.0,
)


def wall_frames(seed: int, duration_s: float, rate_hz: float = 10.0) -> Iterator[PmdFrame]:
    """A camera before a slanted wall with a box that moves; its corners see past the wall."""
    random = np.random.default_rng([seed, 1])
    columns, rows = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    x, y = (columns - CAMERA.cx) / CAMERA.fx, (rows - CAMERA.cy) / CAMERA.fy
    wall_m = 3.0 / (1.0 + 0.15 * x + 0.1 * y)
    for number in range(round(duration_s * rate_hz)):
        phase = 0.4 * number / rate_hz
        box = (np.abs(x - 0.3 * np.sin(phase)) < 0.12) & (np.abs(y) < 0.15)
        depth_m = np.where(box, 2.0, wall_m) + 0.006 * random.standard_normal(wall_m.shape)
        amplitude = (9000.0 / depth_m**2 * (1.0 + 0.02 * random.standard_normal(wall_m.shape))).astype(
            np.uint16
        )
        beyond = np.hypot(x, y) > 0.7
        yield PmdFrame(
            stamp_ns=EPOCH_NS
            + SECOND_NS
            + round(number * SECOND_NS / rate_hz)
            + round(random.normal(0, 5e4)),
            frame_id="",
            depth_m=np.where(beyond, np.nan, depth_m).astype(np.float32),
            amplitude=np.where(beyond, random.integers(1, 30, wall_m.shape), amplitude).astype(np.uint16),
            camera=CAMERA,
        )


PATTERN = LidarInfo(
    azimuth_rad=np.deg2rad(np.linspace(-40.0, 44.0, 60)),
    elevation_rad=np.deg2rad(np.linspace(-15.0, 18.0, 16)),
    scan_time_s=0.06,
    sigma_range_m=0.02,
)


def room_scans(seed: int, duration_s: float, rate_hz: float = 10.0) -> Iterator[LidarScan]:
    """A scanner that sweeps azimuths through a room, 6 m deep; one ray in forty gives no return."""
    random = np.random.default_rng([seed, 2])
    azimuth, elevation = np.meshgrid(PATTERN.azimuth_rad, PATTERN.elevation_rad)
    directions = np.stack(
        (np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)), axis=-1
    )
    walls = np.abs(directions) / np.array([3.0, 1.5, 6.0])
    for number in range(round(duration_s * rate_hz)):
        range_m = 1.0 / walls.max(axis=-1) + 0.02 * random.standard_normal(azimuth.shape)
        range_m[random.random(azimuth.shape) < 1 / 40] = np.nan
        times_s = np.broadcast_to(PATTERN.scan_time_s * (np.arange(60) / 59.0 - 0.5), azimuth.shape)
        yield LidarScan(
            stamp_ns=EPOCH_NS
            + SECOND_NS
            + round(number * SECOND_NS / rate_hz)
            + round(random.normal(0, 1e5)),
            frame_id="",
            points_m=(directions * range_m[..., None]).astype(np.float32),
            intensity=np.ones(azimuth.shape, np.float32),
            time_s=times_s.astype(np.float32),
        )


def watched(
    kind: str,
    frames: Any,
    info: Any,
    *,
    latency_s: float,
    truth: Any = (),
    estimates: Any = (),
    faults: tuple[str, ...] = (),
    seed: int = 0,
    options: Options | None = None,
    mount: RigidTransform = MOUNT,
) -> Observations:
    """Return what came of a sensor of this kind that publishes frames, with faults."""
    desk = Desk(kind, "front", faults=faults, seed=seed, options=options)
    publisher: Any = (CameraPublisher if kind == "pmd" else LidarPublisher)(
        desk, "front", T_chaser_sensor=mount, info=info
    )
    desk.deliver(EPOCH_NS + SECOND_NS)
    for received in truth:
        desk.observer.take(received)
    for odometry, status in estimates:
        hear(desk.observer, ESTIMATE, odometry.stamp_ns, write_odometry(odometry))
        hear(desk.observer, STATUS, status.stamp_ns, write_status(status))
    for frame in frames:
        desk.deliver(frame.stamp_ns + round(latency_s * SECOND_NS))
        publisher.publish(frame)
    return desk.end()


def odometry_of(stamp_ns: int, pose: RigidTransform) -> Odometry:
    return Odometry(
        stamp_ns=stamp_ns, frame_id="chaser", child_frame_id="target", pose=pose,
        linear_m_s=np.zeros(3), angular_rad_s=np.zeros(3),
    )  # fmt: skip


def hear(observer: Observer, topic: Topic, stamp_ns: int, message: Any) -> None:
    """Hand a message over at once: it is beside the sensor and is not checked."""
    observer.take(heard(topic, stamp_ns, message))


def heard(topic: Topic, stamp_ns: int, message: Any) -> Received:
    """Return a message as it arrives at its stamp."""
    payload = memoryview(bytes(encode(message)))
    return Received(topic, "", payload, Attachment(1, 0, bytes(16)), stamp_ns)


def wall_camera(
    *faults: str, seed: int = 0, duration_s: float = 12.0, rate_hz: float = 10.0
) -> list[CheckResult]:
    """Return the results on the camera before a wall."""
    frames = wall_frames(seed, duration_s)
    return judge(
        watched(
            "pmd", frames, INFO, latency_s=0.01, faults=faults, seed=seed, options=Options(rate_hz=rate_hz)
        )
    )


def room_scanner(*faults: str, seed: int = 0, duration_s: float = 12.0) -> list[CheckResult]:
    """Return the results on the scanner in a room."""
    frames = room_scans(seed, duration_s)
    return judge(
        watched(
            "lidar", frames, PATTERN, latency_s=0.04, faults=faults, seed=seed, options=Options(rate_hz=10.0)
        )
    )


TARGET = "mockup"


@cache
def tumbling(time_s: float) -> RigidTransform:
    """Return T_chaser_target of a motion whose rates change: it shows time, range and mount apart."""
    turn = Rotation.from_euler(
        "XYZ", [0.5 * np.sin(0.9 * time_s), 0.6 * np.sin(0.7 * time_s + 1.0), 0.3 * time_s]
    )
    sway = [0.2 * np.sin(1.1 * time_s), 0.15 * np.sin(1.3 * time_s), 3.2 + 0.4 * np.sin(0.8 * time_s)]
    return make_pose(translation_m=sway, rotation=turn * rotation_of(make_pose(rotation=FACING)))


@cache
def tumbling_truth() -> tuple[Received, ...]:
    """Return the truth of this motion at 50 Hz, from 0.5 s to 18 s."""
    stamps = [(step / 50, EPOCH_NS + round(step * SECOND_NS / 50)) for step in range(25, 900)]
    return tuple(
        heard(TRUTH, stamp_ns, write_odometry(odometry_of(stamp_ns, tumbling(time_s))))
        for time_s, stamp_ns in stamps
    )


@cache
def facility_frames(kind: str) -> tuple[Any, ...]:
    """Return frames of the facility's emulator, 5 Hz for 16 s, of a target that tumbles."""
    target = load_target(TARGET)
    sensor: Any
    frames = []
    if kind == "pmd":
        sensor = PmdConfig(
            rate_hz=5.0,
            exposure="fixed",
            T_chaser_sensor=MOUNT,
            camera=Camera(width=120, height=96, fx=200.0, fy=200.0, cx=59.5, cy=47.5),
        )
        emulator: Any = PmdEmulator(sensor, target, seed=1)
    else:
        sensor = LidarConfig(
            rate_hz=5.0,
            motion="skewed",
            T_chaser_sensor=MOUNT,
            pattern={"azimuth_span_deg": 24.0, "elevation_span_deg": 24.0, "step_deg": 0.6},
        )
        emulator = LidarEmulator(sensor, target, seed=1)
    for number in range(80):
        time_s = 1.0 + number / 5.0
        poses = [chained(MOUNT.inv(), tumbling(time_s + offset_s)) for offset_s in sensor.pose_times_s()]
        stamp_ns = EPOCH_NS + round(time_s * SECOND_NS)
        if kind == "pmd":
            shot = emulator.expose(poses, sun_W_m2=np.zeros(3), frame=number)
            images = {"depth_m": shot.depth_m.copy(), "amplitude": shot.amplitude.copy()}
            frames.append(PmdFrame(stamp_ns=stamp_ns, frame_id="", camera=sensor.camera, **images))
        else:
            got = emulator.scan(poses, frame=number)
            points = {"points_m": got.points_m, "intensity": got.intensity, "time_s": got.time_s}
            frames.append(LidarScan(stamp_ns=stamp_ns, frame_id="", **points))
    return sensor, tuple(frames)


def later(frames: Any, late_s: float, *, timed: bool = False) -> list[Any]:
    """Return frames with stamps that are late; ``timed``: the times of their points stay right."""
    restamped = []
    for frame in frames:
        update = {"stamp_ns": frame.stamp_ns + round(late_s * SECOND_NS)}
        if timed:
            update["time_s"] = frame.time_s - np.float32(late_s)
        restamped.append(frame.model_copy(update=update))
    return restamped


def facility(kind: str, *faults: str, seed: int = 0, late_s: float = 0.0) -> list[CheckResult]:
    """Return the results on an emulated sensor of the facility, beside truth and the target's surface."""
    return judge(facility_seen(kind, *faults, seed=seed, late_s=late_s))


def facility_seen(
    kind: str, *faults: str, seed: int = 0, late_s: float = 0.0, timed: bool = False
) -> Observations:
    """Return what came of an emulated sensor of the facility, beside truth; ``late_s`` as of ``later``."""
    sensor, frames = facility_frames(kind)
    options = Options(rate_hz=5.0, surface=Surface.of(load_target(TARGET)))
    return watched(
        kind, later(frames, late_s, timed=timed), sensor.info(), latency_s=sensor.latency_s - late_s,
        truth=tumbling_truth(), faults=faults, seed=seed, options=options, mount=MOUNT,
    )  # fmt: skip


@cache
def ideal_frames() -> tuple[PmdFrame, ...]:
    """Return frames of an ideal camera with white noise, 5 Hz for 16 s, of the tumbling target."""
    target = load_target(TARGET)
    camera = Camera(width=120, height=96, fx=200.0, fy=200.0, cx=59.5, cy=47.5)
    frames = []
    for number in range(80):
        time_s = 1.0 + number / 5.0
        pose = chained(MOUNT.inv(), tumbling(time_s))
        frame = depth_frame(target, pose, noise_m=0.005, camera=camera, seed=number)
        lit = (1000.0 * np.nan_to_num(frame.depth_m)).astype(np.uint16)
        update = {"stamp_ns": EPOCH_NS + round(time_s * SECOND_NS), "amplitude": lit}
        frames.append(frame.model_copy(update=update))
    return tuple(frames)


def ideal_camera(*faults: str, seed: int = 0, estimates: Any = (), late_s: float = 0.0) -> list[CheckResult]:
    """Return the results on the ideal camera, beside truth or estimates; its exposure lasts 16 ms."""
    against = "estimate" if estimates else None
    options = Options(rate_hz=5.0, surface=Surface.of(load_target(TARGET)), against=against)
    info = INFO.model_copy(update={"integration_time_s": 16e-3})
    return judge(
        watched(
            "pmd",
            later(ideal_frames(), late_s),
            info,
            latency_s=0.01 - late_s,
            truth=() if estimates else tumbling_truth(),
            estimates=estimates,
            faults=faults,
            seed=seed,
            options=options,
        )
    )


def failed(results: list[CheckResult]) -> set[str]:
    """Return the faults that results name."""
    return {fault for result in results for fault in result.faults}
