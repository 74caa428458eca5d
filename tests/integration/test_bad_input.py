"""Bad input to the estimator's daemon: refused with a counted reason and a status; good frames go on."""

import time
from contextlib import ExitStack

import numpy as np
import pytest
from live_bus import TIMEOUT_S, Bus, collect, daemon, first
from pmd_frames import depth_frame
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_estimator.daemon import run
from rpod_geometry.rays import RayGrid, cast
from rpod_runtime import Inbox
from rpod_schemas.config.estimator import EstimatorConfig, NavigatorConfig, PmdInput
from rpod_schemas.control import Accepted, ResetRequest, StatusReply
from rpod_schemas.messages import (
    read_diagnostics,
    read_odometry,
    read_status,
    write_camera,
    write_image,
    write_points,
    write_transforms,
)
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.rmw.wire import Attachment
from rpod_schemas.topics import (
    AMPLITUDE,
    CAMERA_INFO,
    DEPTH,
    DIAGNOSTICS,
    ESTIMATE,
    STATUS,
    TF_STATIC,
    Namespace,
)
from rpod_schemas.types import Camera, EstimatorStatus, Mode, Source
from rpod_target import Target, load_target

KEYS = Namespace()
CAMERA = Camera(width=88, height=72, fx=170.0, fy=170.0, cx=43.5, cy=35.5)
"""Small, so that no frame is dropped by a bus that is short of processor time."""
MOUNT = make_pose(translation_m=[0.0, -0.05, 0.0])
T_CHASER_TARGET = make_pose(
    rotation=Rotation.from_euler("ZYX", [12.0, 65.0, 5.0], degrees=True), translation_m=[0.05, 0.0, 5.0]
)
MILLISECOND_NS = 1_000_000


def lit_from_the_camera(target: Target, T_sensor_target: RigidTransform) -> np.ndarray:
    """Return the amplitude of a Lambertian body before a dark sky, shape (rows, columns)."""
    rays = RayGrid.pinhole(CAMERA)
    shown = cast(rays, target.triangles_m, T_sensor_target).triangle
    normals = T_sensor_target.rotation.apply(target.normals)[shown]
    cosine = np.abs(np.einsum("ijk,ijk->ij", normals, rays.directions))
    return np.where(shown < 0, 5, 800 * cosine).astype(np.uint16)


class Lab:
    """An estimator at work on the bus, a camera to feed it with, and its statuses."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.statuses, self.odometry, self.health = Inbox(), Inbox(), Inbox()
        watcher = bus.node("watcher")
        for topic, inbox in ((STATUS, self.statuses), (ESTIMATE, self.odometry), (DIAGNOSTICS, self.health)):
            watcher.subscribe(topic, inbox.put, recover=True)
        self.watcher = watcher
        camera = bus.node("camera")
        camera.publisher(TF_STATIC).publish(write_transforms(0, [("chaser", "pmd_optical", MOUNT)]))
        self.parts = {topic: camera.publisher(topic.of("pmd")) for topic in (CAMERA_INFO, DEPTH, AMPLITUDE)}
        target = load_target("mockup")
        self.frame = depth_frame(target, MOUNT.inv() * T_CHASER_TARGET, noise_m=0.005, camera=CAMERA)
        self.sent = 0
        self.amplitude = lit_from_the_camera(target, MOUNT.inv() * T_CHASER_TARGET)

    def messages(self, stamp_ns: int, frame_id: str = "pmd_optical") -> dict:
        self.sent += 1
        depth_m = self.frame.depth_m * np.float32(1.0 + 1e-6 * self.sent)  # noise never repeats
        return {
            CAMERA_INFO: write_camera(stamp_ns, frame_id, CAMERA),
            DEPTH: write_image(stamp_ns, frame_id, depth_m, "32FC1"),
            AMPLITUDE: write_image(stamp_ns, frame_id, self.amplitude, "mono16"),
        }

    def send(self, messages: dict, damage=None) -> None:
        for topic, message in messages.items():
            payload = encode(message)
            self.parts[topic].put(bytearray(damage(payload)) if damage and topic == DEPTH else payload)

    def expose(self, **changes) -> int:
        """Send a good frame; return its stamp."""
        stamp_ns = time.time_ns()
        self.send(self.messages(stamp_ns, **changes))
        return stamp_ns

    def status(self, stamp_ns: int) -> EstimatorStatus:
        """Return the status of the frame with a stamp."""

        def pick(received):
            status = read_status(received.decode())
            return status if status.stamp_ns == stamp_ns else None

        found = first(self.statuses, pick)
        assert found is not None, f"no status of {stamp_ns}"
        return found

    def counter(self, name: str) -> int:
        return self.watcher.ask("estimator", "status", StatusReply, timeout_s=TIMEOUT_S).counters.get(name, 0)

    def told(self, name: str) -> bool:
        """Return whether the diagnostics on the bus name a counter, now or soon."""
        return bool(
            first(
                self.health,
                lambda received: any(name in item.values for item in read_diagnostics(received.decode())),
            )
        )


@pytest.fixture(scope="module")
def lab(endpoint):
    config = EstimatorConfig(
        target="mockup",
        bus={"connect": endpoint},
        sensors=(PmdInput(),),
        initial_pose=T_CHASER_TARGET,
        stale_after_s=600.0,
        navigator=NavigatorConfig(silence_timeout_s=600.0),
    )
    with ExitStack() as stack:
        lab = Lab(Bus(endpoint, stack))
        stack.enter_context(daemon(run, config))
        ready = first(
            lab.health, lambda received: "estimator" in str(received.decode().status[0].name), 120.0
        )
        assert ready
        for _ in range(100):
            lab.expose()
            if lab.statuses.wait(0.2):
                break
        yield lab


@pytest.fixture(autouse=True)
def still_at_work(lab):
    """After every test a good frame is tracked as if nothing had been."""
    yield
    stamp_ns = lab.expose()
    status = lab.status(stamp_ns)
    assert (status.accepted, status.mode, status.reason) == (True, Mode.TRACKING, "")
    odometry = [read_odometry(item.decode()) for item in collect(lab.odometry, 1)][-1]
    attitude_rad, position_m = pose_error(T_CHASER_TARGET, odometry.pose)
    assert np.linalg.norm(attitude_rad) < 0.03
    assert np.linalg.norm(position_m) < 0.05


def test_a_good_frame_is_tracked_and_timed(lab):
    status = lab.status(lab.expose())
    assert (status.source, status.sensor, status.frame_id) == (Source.PMD_JOINT, "pmd", "chaser")
    assert status.processing_s > 0.0
    assert status.inliers > 100


def changed(message, **changes):
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def nan_image(stamp_ns):
    return write_image(stamp_ns, "pmd_optical", np.full((72, 88), np.nan, np.float32), "32FC1")


CONTENT = {
    "filled with NaN": (DEPTH, nan_image, "not_finite"),
    "of the wrong size": (
        DEPTH,
        lambda stamp_ns: write_image(stamp_ns, "pmd_optical", np.ones((10, 10), np.float32), "32FC1"),
        "wrong_size",
    ),
    "of the wrong encoding": (
        DEPTH,
        lambda stamp_ns: changed(
            write_image(stamp_ns, "pmd_optical", np.ones((72, 88), np.float32), "32FC1"), encoding="bgr8"
        ),
        "wrong_type",
    ),
    "with a camera that is none": (
        CAMERA_INFO,
        lambda stamp_ns: changed(write_camera(stamp_ns, "pmd_optical", CAMERA), k=np.full(9, np.nan)),
        "not_finite",
    ),
    "of another message type": (
        DEPTH,
        lambda stamp_ns: write_points(stamp_ns, "pmd_optical", {n: np.ones(9, np.float32) for n in "xyz"}),
        "",
    ),
}


@pytest.mark.parametrize("what", CONTENT)
def test_a_frame_is_refused_for_what_it_holds(lab, what):
    topic, make, reason = CONTENT[what]
    stamp_ns = time.time_ns()
    lab.send(lab.messages(stamp_ns) | {topic: make(stamp_ns)})
    status = lab.status(stamp_ns)
    assert not status.accepted
    assert status.mode == Mode.TRACKING
    assert status.reason.startswith(reason)
    counted = f"rejected/{topic.of('pmd').name}/{status.reason.split(':')[0]}"
    assert lab.counter(counted) >= 1
    assert lab.told(counted)


@pytest.mark.parametrize("kept", [-100, 2000, 14])
def test_a_truncated_frame_is_refused_by_its_stamp(lab, kept):
    stamp_ns = time.time_ns()
    lab.send(lab.messages(stamp_ns), lambda payload: payload[:kept])
    status = lab.status(stamp_ns)
    assert not status.accepted
    assert status.reason.split(":")[0] in ("malformed", "wrong_size")


@pytest.mark.parametrize(
    "junk", [b"", b"\x00", b"junk" * 100, bytes(500), b"\x00\x01\x00\x00" + b"\xff" * 400]
)
def test_junk_is_counted(lab, junk):
    before = lab.counter("rejected/pmd/depth/image_raw/malformed")
    lab.parts[DEPTH].put(bytearray(junk))
    stamp_ns = lab.expose()
    assert lab.status(stamp_ns).accepted
    counters = lab.watcher.ask("estimator", "status", StatusReply, timeout_s=TIMEOUT_S).counters
    late = counters.get("rejected/pmd/depth/image_raw/late", 0)  # zeros are a stamp: 1970
    assert counters.get("rejected/pmd/depth/image_raw/malformed", 0) + late > before


@pytest.mark.parametrize(
    ("age_ms", "reason"), [(1500.0, "late"), (37_000.0, "late"), (-500.0, "future"), (-1e9, "future")]
)
def test_a_frame_with_a_wrong_stamp_is_refused_with_the_reason(lab, age_ms, reason):
    stamp_ns = time.time_ns() - round(age_ms * MILLISECOND_NS)
    lab.send(lab.messages(stamp_ns))
    status = lab.status(stamp_ns)
    assert not status.accepted
    assert status.reason.startswith(f"{reason}: ")
    assert "check the sensor's clock" in status.reason
    assert lab.counter(f"rejected/pmd/depth/image_raw/{reason}") >= 1


def test_a_frame_that_is_sent_twice_is_a_duplicate(lab):
    stamp_ns = lab.expose()
    assert lab.status(stamp_ns).accepted
    lab.send(lab.messages(stamp_ns))
    status = lab.status(stamp_ns)
    assert not status.accepted
    assert status.reason.startswith("duplicate")


def test_a_message_that_is_sent_twice_under_one_number_is_counted(lab):
    key = KEYS.key(DEPTH.of("pmd"))
    before = lab.counter("rejected/pmd/depth/image_raw/duplicate")
    payload = bytes(encode(nan_image(1)))
    for _ in range(3):
        lab.watcher._session.put(key, payload, attachment=Attachment(7, 0, b"twice".ljust(16)).pack())
    assert lab.status(lab.expose()).accepted
    assert lab.counter("rejected/pmd/depth/image_raw/duplicate") == before + 2


@pytest.mark.parametrize("topic", [CAMERA_INFO, DEPTH, AMPLITUDE], ids=lambda topic: topic.name)
@pytest.mark.parametrize("ahead", [2**40, 500])
def test_a_forged_message_under_a_known_gid_does_not_silence_the_camera(lab, topic, ahead):
    name, part = topic.of("pmd").name, lab.parts[topic]
    before = lab.counter(f"rejected/{name}/second_source")
    assert lab.status(lab.expose()).accepted
    forged = Attachment(part.published + ahead, 0, part._gid).pack()
    lab.watcher._session.put(KEYS.key(topic.of("pmd")), bytes(encode(nan_image(1))), attachment=forged)
    for _ in range(3):
        assert lab.status(lab.expose()).accepted
    assert lab.counter(f"rejected/{name}/second_source") == before + 1
    assert lab.told(f"second_source/{name}")


def test_a_mount_that_is_told_once_under_number_0_is_used(lab):
    mount = write_transforms(0, [("chaser", "told_once", MOUNT)])
    first_of_all = Attachment(0, 0, b"one shot".ljust(16)).pack()
    lab.watcher._session.put(KEYS.key(TF_STATIC), bytes(encode(mount)), attachment=first_of_all)
    for _ in range(20):
        status = lab.status(lab.expose(frame_id="told_once"))
        if status.accepted:
            break
    assert status.accepted, status.reason


def test_an_older_attachment_is_refused_by_name(lab):
    key = KEYS.key(DEPTH.of("pmd"))
    lab.watcher._session.put(key, b"", attachment=b"\x0fsequence_number" + bytes(50))
    assert lab.status(lab.expose()).accepted
    assert lab.counter("rejected/pmd/depth/image_raw/old_attachment") == 1


def test_a_frame_of_an_unknown_frame_of_reference_is_refused(lab):
    stamp_ns = lab.expose(frame_id="nowhere")
    status = lab.status(stamp_ns)
    assert status.reason.startswith("unknown_frame: no chain from 'nowhere' to 'chaser'")
    assert lab.counter("rejected/pmd/depth/image_raw/unknown_frame") >= 1


@pytest.mark.parametrize("depth_m", [0.0, -3.0, np.inf, 4.0, 1e-3, 1e9])
def test_an_image_without_the_target_is_rejected_and_the_prediction_goes_on(lab, depth_m):
    stamp_ns = time.time_ns()
    image = np.full((CAMERA.height, CAMERA.width), depth_m, np.float32)
    dark = np.full(image.shape, 5, np.uint16)
    empty = {
        DEPTH: write_image(stamp_ns, "pmd_optical", image, "32FC1"),
        AMPLITUDE: write_image(stamp_ns, "pmd_optical", dark, "mono16"),
    }
    lab.send(lab.messages(stamp_ns) | empty)
    status = lab.status(stamp_ns)
    assert not status.accepted
    assert status.reason
    assert status.mode == Mode.TRACKING


@pytest.mark.parametrize(
    "camera",
    [
        {"fx": 1e-6, "fy": 1e-6},
        {"fx": 1e9, "fy": 1e9},
        {"cx": 1e6},
        {"distortion": np.array([-9.0, 0.0, 0.0, 0.0, 0.0])},
        {"distortion": np.full(5, 1e6)},
    ],
    ids=["no focal length", "all focal length", "looking aside", "folded", "wild"],
)
def test_a_lens_that_no_camera_has_is_no_end(lab, camera):
    stamp_ns = time.time_ns()
    lens = write_camera(stamp_ns, "pmd_optical", CAMERA.model_copy(update=camera))
    lab.send(lab.messages(stamp_ns) | {CAMERA_INFO: lens})
    assert not lab.status(stamp_ns).accepted


def test_a_reset_in_other_axes_is_refused_and_one_in_the_chasers_is_taken(lab):
    with pytest.raises(Exception, match="poses are taken in 'chaser'"):
        lab.watcher.ask(
            "estimator", "reset", Accepted, ResetRequest(pose=T_CHASER_TARGET, frame_id="pmd_optical")
        )
    assert lab.watcher.ask("estimator", "reset", Accepted, ResetRequest(pose=T_CHASER_TARGET)).accepted
