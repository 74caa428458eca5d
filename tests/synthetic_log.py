"""Logs with known errors, written as the ICD has them: what the analysis must find is put in by hand."""

import json
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from mcap.writer import CompressionType, Writer
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.rays import RayGrid, cast
from rpod_motion.truth_error import TruthError
from rpod_schemas.logs import (
    COMPLETENESS,
    CONFIGURATION,
    COUNTS,
    MESSAGE_ENCODING,
    PROFILE,
    SCHEMA_ENCODING,
    SOFTWARE,
    Completeness,
    TopicCount,
    shortfalls,
)
from rpod_schemas.messages import (
    write_camera,
    write_clock,
    write_diagnostics,
    write_image,
    write_integrity,
    write_odometry,
    write_pmd_info,
    write_points,
    write_pose_stamped,
    write_status,
    write_transforms,
)
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw.cdr import definition, encode
from rpod_schemas.topics import (
    AMPLITUDE,
    CAMERA_INFO,
    CHASER,
    CLOCK,
    CONTRADICTION,
    DEPTH,
    DIAGNOSTICS,
    ESTIMATE,
    ESTIMATE_FRAME,
    ESTIMATE_POSE,
    INTEGRITY,
    PMD_INFO,
    POINTS,
    STATUS,
    TARGET,
    TARGET_ESTIMATE,
    TF_STATIC,
    TRUTH,
    Topic,
    optical_frame,
)
from rpod_schemas.types import (
    Camera,
    Diagnostic,
    EstimatorStatus,
    Health,
    Integrity,
    Mode,
    Odometry,
    PmdInfo,
    Source,
)

EPOCH_NS = 1_767_225_600_000_000_000
T_CHASER_SENSOR = make_pose(
    rotation=Rotation.from_euler("ZYX", [30.0, -20.0, 100.0], degrees=True), translation_m=(0.4, -0.1, 0.2)
)
TINY_CAMERA = Camera(width=16, height=12, fx=14.0, fy=14.0, cx=7.5, cy=5.5)
PMD_CAMERA = Camera(
    width=352,
    height=287,
    fx=358.8,
    fy=359.1,
    cx=179.2,
    cy=143.1,
    distortion=np.array([-0.35, 0.15, 0.0, 0.0, 0.0]),
)


def approach(time_s: float) -> RigidTransform:
    """T_sensor_target of a tumbling target that comes nearer along the boresight."""
    turn = Rotation.from_rotvec(np.radians([4.0, 6.0, -3.0]) * time_s)
    return make_pose(
        rotation=turn * Rotation.from_euler("ZYX", [20.0, 110.0, 40.0], degrees=True),
        translation_m=(0.15 * np.sin(0.4 * time_s), 0.1 * np.cos(0.3 * time_s), 4.8 - 0.08 * time_s),
    )


def see_depth(target: Any, camera: Camera) -> Callable[[RigidTransform, int], tuple[Any, Any]]:
    """Return a renderer of depth and amplitude: rays, a cosine, noise keyed by the frame's number."""
    grid = RayGrid.pinhole(camera)

    def see(T_sensor_target: RigidTransform, number: int) -> tuple[Any, Any]:
        noise = np.random.default_rng((1, number))
        hits = cast(grid, target.triangles_m, T_sensor_target)
        normals = T_sensor_target.rotation.apply(target.normals)[hits.triangle]
        cosine = np.abs((normals * grid.directions).sum(axis=-1))
        seen = hits.triangle >= 0
        range_m = np.where(seen, hits.range_m, np.nan)
        depth_m = range_m * grid.directions[..., 2] + noise.normal(0.0, 0.015, range_m.shape)
        amplitude = np.where(seen, 9000.0 * cosine / np.where(seen, range_m, 1.0) ** 2, 0.0)
        amplitude += np.abs(noise.normal(0.0, 12.0, amplitude.shape))
        return depth_m.astype(np.float32), amplitude.astype(np.uint16)

    return see


def see_points(target: Any) -> Callable[[RigidTransform, int], tuple[Any, Any]]:
    """Return a renderer of LIDAR points and intensity, 40 x 40 rays over 20 degrees."""
    angles = np.radians(np.linspace(-10.0, 10.0, 40))
    grid = RayGrid.azimuth_elevation(angles, angles)

    def see(T_sensor_target: RigidTransform, number: int) -> tuple[Any, Any]:
        noise = np.random.default_rng((1, number))
        hits = cast(grid, target.triangles_m, T_sensor_target)
        range_m = np.where(hits.triangle >= 0, hits.range_m, np.nan) + noise.normal(0.0, 0.01, grid.shape)
        return (range_m[..., None] * grid.directions).astype(np.float32), np.ones(grid.shape, np.float32)

    return see


@dataclass(frozen=True, eq=False)
class Frame:
    """What the estimator is made to say of a frame; errors as the ICD measures them."""

    mode: Mode = Mode.TRACKING
    attitude_rad: Any = (0.0, 0.0, 0.0)
    """Log(R_truth^T R_estimate), target axes."""
    position_m: Any = (0.0, 0.0, 0.0)
    """In the sensor's axes."""
    covariance: Any = field(default_factory=lambda: np.zeros((6, 6)))
    """Covariance of (dp, dtheta), chaser axes."""
    reason: str = ""
    nis: float = float("nan")
    marked: Any = None
    """Pixels that contradict the pose, shape (rows, columns); None for none."""
    integrity: dict[str, Any] | None = None
    """State, reason, levels and limits; None for an estimator that tells none."""
    latency_s: float = 0.06
    again_s: float | None = None
    """Time from the stamp to another publication of the estimate; None for none."""
    processing_s: float = 0.03
    evidence: dict[str, float] = field(default_factory=dict)


@dataclass
class SyntheticRun:
    """A run to be written as a log. Frame k of the sensor is at k / rate_hz; the truth covers all of them."""

    duration_s: float = 2.0
    rate_hz: float = 10.0
    truth_rate_hz: float = 250.0
    kind: Literal["pmd", "lidar"] = "pmd"
    name: str = "pmd"
    camera: Camera = TINY_CAMERA
    info: PmdInfo | None = None
    """What the camera says of itself."""
    target: str | None = None
    """Whose wireframe is drawn; its surface is seen where ``render`` is set."""
    frames: Mapping[str, RigidTransform] = field(default_factory=dict)
    """T_target_frame of the target's frames that the estimator publishes, by name."""
    render: Callable[[RigidTransform, int], tuple[Any, Any]] | None = None
    """Makes depth and amplitude, or points and intensity, of T_sensor_target and a frame's number."""
    pose: Callable[[float], RigidTransform] = approach
    """T_sensor_target at a time."""
    frame: Callable[[int, float], Frame] = field(default=lambda _number, _time_s: Frame())
    """What the estimator says of a frame, by its number and time."""
    truth_error: TruthError | None = None
    """Perturbs the truth, which states its covariance."""
    truth_gaps_s: tuple[tuple[float, float], ...] = ()
    """Where the truth is missing: from, to, ends excluded."""
    clock: bool = False
    """Whether time comes from the topic ``clock``."""
    skipped: Callable[[int], bool] = field(default=lambda _number: False)
    """Which frames, by number, the estimator passes over."""
    dropped: int = 0
    late: int = 0
    """Frames that the estimator says it refused because they were late."""
    unlogged: int = 0
    """Depth images that were published and did not reach the log, from the second one on."""
    amplitude_until_s: float = np.inf
    """From then on no amplitude is sent."""
    namespace: str = ""
    with_truth: bool = True
    with_estimates: bool = True
    states_completeness: bool = True
    """Whether the log says of itself whether it is complete."""
    continues: str | None = None
    """Name of the file from which the log says that it goes on."""
    part: tuple[float, float] = (-np.inf, np.inf)
    """Only what arrives in this time; latched messages always."""

    def write(self, path: Path) -> Path:
        """Write the log."""
        with path.open("wb") as stream:
            _LogWriter(self, stream).write()
        return path


class _LogWriter:
    def __init__(self, run: SyntheticRun, stream: Any) -> None:
        self.run = run
        self.writer = Writer(stream, chunk_size=1 << 16, compression=CompressionType.LZ4)
        self.channels: dict[Topic, int] = {}
        self.sequences: Counter[str] = Counter()
        self.written: Counter[str] = Counter()
        self.missed: Counter[str] = Counter()
        self.frame_id = optical_frame(run.name) if run.kind == "pmd" else run.name

    def write(self) -> None:
        self.writer.start(profile=PROFILE, library="synthetic")
        self.put(TF_STATIC, EPOCH_NS, write_transforms(EPOCH_NS, [(CHASER, self.frame_id, T_CHASER_SENSOR)]))
        if self.run.info is not None:
            self.put(PMD_INFO.of(self.run.name), EPOCH_NS, write_pmd_info(EPOCH_NS, "", self.run.info))
        events: list[tuple[float, int, Callable[[], None]]] = []
        steps = round(self.run.duration_s * self.run.truth_rate_hz) + 3
        for k in range(-2, steps):
            time_s = k / self.run.truth_rate_hz
            events.append((time_s, 0, lambda time_s=time_s: self.truth(time_s)))
        for k in range(round(self.run.duration_s * self.run.rate_hz) + 1):
            time_s = k / self.run.rate_hz
            events.append((time_s, 1, lambda k=k, time_s=time_s: self.sensor_frame(k, time_s)))
        events += [
            (float(k), 2, lambda k=k: self.diagnostics(float(k))) for k in range(int(self.run.duration_s) + 1)
        ]
        for _, _, event in sorted(events, key=lambda item: item[:2]):
            event()
        self.diagnostics(self.run.duration_s + 0.5)
        self.metadata()
        self.writer.finish()

    def put(self, topic: Topic, stamp_ns: int, message: Any, *, delay_s: float = 0.001) -> None:
        self.sequences[topic.name] += 1
        publish_ns = stamp_ns + round(delay_s * 1e9)
        first_s, last_s = self.run.part
        if not topic.latched and not first_s <= (publish_ns - EPOCH_NS) * 1e-9 < last_s:
            return
        if topic not in self.channels:
            schema = self.writer.register_schema(topic.type, SCHEMA_ENCODING, definition(topic.type).encode())
            name = self.channel_topic(topic.name)
            self.channels[topic] = self.writer.register_channel(name, MESSAGE_ENCODING, schema)
        self.written[topic.name] += 1
        self.writer.add_message(
            self.channels[topic],
            log_time=publish_ns + 200_000,
            publish_time=publish_ns,
            data=bytes(encode(message)),
            sequence=self.sequences[topic.name],
        )

    def channel_topic(self, name: str) -> str:
        return f"/{self.run.namespace}/{name}" if self.run.namespace else f"/{name}"

    def truth(self, time_s: float) -> None:
        stamp_ns = _stamp_ns(time_s)
        if self.run.clock:
            self.put(CLOCK, stamp_ns, write_clock(stamp_ns))
        if not self.run.with_truth or any(a < time_s < b for a, b in self.run.truth_gaps_s):
            return
        pose = T_CHASER_SENSOR * self.run.pose(time_s)
        error = self.run.truth_error
        odometry = (
            _odometry(stamp_ns, TARGET, pose)
            if error is None
            else _odometry(stamp_ns, TARGET, error.perturb(pose), error.covariance)
        )
        self.put(TRUTH, stamp_ns, write_odometry(odometry))

    def sensor_frame(self, number: int, time_s: float) -> None:
        stamp_ns = _stamp_ns(time_s)
        if self.run.kind == "pmd":
            self.pmd_frame(stamp_ns, number, time_s)
        else:
            self.lidar_scan(stamp_ns, number, time_s)
        if self.run.with_estimates and not self.run.skipped(number):
            self.estimate(self.run.frame(number, time_s), stamp_ns, time_s)

    def pmd_frame(self, stamp_ns: int, number: int, time_s: float) -> None:
        camera = self.run.camera
        if self.run.render:
            depth_m, amplitude = self.run.render(self.run.pose(time_s), number)
        else:
            depth_m = np.full((camera.height, camera.width), 4.0 + 0.001 * number, np.float32)
            amplitude = np.full(depth_m.shape, 700, np.uint16)
        name = self.run.name
        self.put(CAMERA_INFO.of(name), stamp_ns, write_camera(stamp_ns, self.frame_id, camera))
        if 1 <= number <= self.run.unlogged:
            self.sequences[DEPTH.of(name).name] += 1
            self.missed[DEPTH.of(name).name] += 1
        else:
            self.put(DEPTH.of(name), stamp_ns, write_image(stamp_ns, self.frame_id, depth_m, "32FC1"))
        if time_s < self.run.amplitude_until_s:
            self.put(AMPLITUDE.of(name), stamp_ns, write_image(stamp_ns, self.frame_id, amplitude, "mono16"))

    def lidar_scan(self, stamp_ns: int, number: int, time_s: float) -> None:
        if self.run.render:
            points_m, intensity = self.run.render(self.run.pose(time_s), number)
        else:
            points_m = np.tile(np.float32([0.0, 0.0, 4.0]), (6, 8, 1))
            intensity = np.ones((6, 8), np.float32)
        fields = dict(zip("xyz", np.moveaxis(points_m, -1, 0), strict=True)) | {"intensity": intensity}
        self.put(POINTS.of(self.run.name), stamp_ns, write_points(stamp_ns, self.frame_id, fields))

    def estimate(self, frame: Frame, stamp_ns: int, time_s: float) -> None:
        if frame.mode == Mode.TRACKING:
            T_sensor_target = self.run.pose(time_s)
            wrong = make_pose(
                rotation=T_sensor_target.rotation * Rotation.from_rotvec(np.asarray(frame.attitude_rad)),
                translation_m=T_sensor_target.translation + np.asarray(frame.position_m),
            )
            odometry = _odometry(stamp_ns, TARGET_ESTIMATE, T_CHASER_SENSOR * wrong, frame.covariance)
            self.put(ESTIMATE, stamp_ns, write_odometry(odometry), delay_s=frame.latency_s)
            if frame.again_s is not None:
                self.put(ESTIMATE, stamp_ns, write_odometry(odometry), delay_s=frame.again_s)
            self.put(ESTIMATE_POSE, stamp_ns, write_pose_stamped(odometry), delay_s=frame.latency_s)
            for name, pose in self.run.frames.items():
                message = write_pose_stamped(odometry, T_child_frame=pose)
                self.put(ESTIMATE_FRAME.at(name), stamp_ns, message, delay_s=frame.latency_s)
        status = EstimatorStatus(
            stamp_ns=stamp_ns,
            frame_id=CHASER,
            mode=frame.mode,
            source=Source.PMD_DEPTH if self.run.kind == "pmd" else Source.LIDAR,
            sensor=self.run.name,
            accepted=not frame.reason,
            reason=frame.reason,
            evidence=frame.evidence,
            nis=frame.nis,
            processing_s=frame.processing_s,
        )
        if frame.marked is not None:
            image = write_image(stamp_ns, self.frame_id, frame.marked * np.uint8(255), "mono8")
            self.put(CONTRADICTION, stamp_ns, image, delay_s=frame.latency_s)
        if frame.integrity is not None:
            told = Integrity(stamp_ns=stamp_ns, frame_id=CHASER, risk=1e-6, **frame.integrity)
            self.put(INTEGRITY, stamp_ns, write_integrity(told), delay_s=frame.latency_s)
        self.put(STATUS, stamp_ns, write_status(status), delay_s=frame.latency_s)

    def diagnostics(self, time_s: float) -> None:
        stamp_ns = _stamp_ns(time_s)
        owners = {"motion": (TRUTH, CLOCK), "estimator": (ESTIMATE, ESTIMATE_POSE, STATUS)}
        mine = [topic for topics in owners.values() for topic in topics]
        owners["emulator"] = tuple(topic for topic in self.channels if topic not in (*mine, DIAGNOSTICS))
        for service, topics in owners.items():
            values = {f"published/{topic.name}": str(self.sequences[topic.name]) for topic in topics}
            if service == "estimator":
                values[f"dropped/{self.run.name}"] = str(self.run.dropped)
                values[f"inputs/{self.run.name}/used"] = "7"
                values[f"inputs/{self.run.name}/not_used/late"] = str(self.run.late)
                values[f"input/{self.run.name}/late"] = "late: 1.250 s old"
            diagnostic = Diagnostic(
                stamp_ns=stamp_ns, name=service, level=Health.OK, message="running", values=values
            )
            self.put(DIAGNOSTICS, stamp_ns, write_diagnostics([diagnostic]))

    def metadata(self) -> None:
        bus = {"namespace": self.run.namespace}
        estimator = {"target": self.run.target, "bus": bus, "sensors": [{"name": self.run.name}]}
        configuration = {
            "emulator": {"seed": 7, "bus": bus},
            "estimator": estimator,
            "logger": {"name": "synthetic-approach", "bus": bus},
        }
        self.writer.add_metadata(SOFTWARE, {"name": "rpod", "version": "0.1.0", "target_digest": ""})
        self.writer.add_metadata(
            CONFIGURATION, {name: json.dumps(model) for name, model in configuration.items()}
        )
        counts = {
            self.channel_topic(topic.name): TopicCount(
                received=self.written[topic.name],
                written=self.written[topic.name],
                missed=self.missed[topic.name],
            )
            for topic in self.channels
        }
        self.writer.add_metadata(COUNTS, {topic: count.model_dump_json() for topic, count in counts.items()})
        if self.run.states_completeness:
            reasons = shortfalls(counts, {topic: count.written for topic, count in counts.items()})
            record = Completeness(complete=not reasons, reasons=reasons, continues=self.run.continues)
            self.writer.add_metadata(COMPLETENESS, record.record())


def _stamp_ns(time_s: float) -> int:
    return EPOCH_NS + round(time_s * 1e9)


def _odometry(stamp_ns: int, child: str, pose: RigidTransform, covariance: Any = None) -> Odometry:
    return Odometry(
        stamp_ns=stamp_ns,
        frame_id=CHASER,
        child_frame_id=child,
        pose=pose,
        linear_m_s=np.zeros(3),
        angular_rad_s=np.zeros(3),
        pose_covariance=np.zeros((6, 6)) if covariance is None else np.asarray(covariance, float),
    )
