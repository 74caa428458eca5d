"""A ROS 2 camera on rmw_zenoh, without a line of the facility's code, tracked by a preset and a mount."""

import struct
import time
from functools import cache
from pathlib import Path

import numpy as np
import open3d as o3d
import zenoh
from live_bus import TIMEOUT_S, daemon, first
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from rpod_estimator.daemon import run
from rpod_runtime import Inbox
from rpod_schemas.config.base import check
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.messages import read_odometry
from rpod_schemas.poses import make_pose
from rpod_schemas.topics import ESTIMATE
from rpod_target import load_target

PRESET = Path(__file__).parents[2] / "deploy" / "sensors" / "realsense.yaml"
EXPOSURE_S = 0.02
WIDTH, HEIGHT, FOCAL_PX = 88, 72, 170.0
T_CHASER_TARGET = make_pose(
    rotation=Rotation.from_euler("ZYX", [12.0, 65.0, 5.0], degrees=True), translation_m=[0.05, 0.0, 4.0]
)
MOUNT = {"translation_m": [0.0, -0.05, 0.0], "euler_321_deg": [0.0, 0.0, 0.0]}


@cache
def pictures():
    """Return depth, mm, and brightness of the mock-up by Open3D: Lambert's law, light from the camera."""
    view = make_pose(translation_m=MOUNT["translation_m"]).inv() * T_CHASER_TARGET
    corners = view.apply(load_target("mockup").triangles_m.reshape(-1, 3)).astype(np.float32)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(corners, np.arange(len(corners), dtype=np.uint32).reshape(-1, 3))
    u, v = np.meshgrid(np.arange(WIDTH) - 43.5, np.arange(HEIGHT) - 35.5)
    ways = np.stack((u / FOCAL_PX, v / FOCAL_PX, np.ones_like(u)), axis=-1).astype(np.float32)
    hits = scene.cast_rays(np.concatenate((np.zeros_like(ways), ways), axis=-1))
    depth_m, normals = hits["t_hit"].numpy(), hits["primitive_normals"].numpy()
    seen = np.isfinite(depth_m)
    cosine = np.abs((normals * ways).sum(axis=-1)) / np.linalg.norm(ways, axis=-1)
    rng = np.random.default_rng(3)
    noisy_m = np.where(seen, depth_m, 0.0) + seen * rng.normal(0.0, 0.004, depth_m.shape)
    bright = np.where(seen, 180.0 * cosine, 0.0) + np.abs(rng.normal(3.0, 1.0, depth_m.shape))
    return np.rint(1e3 * noisy_m).astype("<u2"), np.rint(bright).clip(0, 250).astype("u1")


class RosCamera:
    """Publishes as a rmw_zenoh node does: keys, CDR and attachments by rosbags and by hand."""

    def __init__(self, session):
        self._session, self._types = session, get_typestore(Stores.ROS2_HUMBLE)
        self._sequence, self._gid = {}, np.random.default_rng(7).bytes(16)
        self._frames = 0

    def expose(self):
        """Publish a frame stamped with the start of its exposure, and each tenth time the camera_info."""
        stamp_ns = time.time_ns() - round(1.5 * EXPOSURE_S * 1e9)
        types = self._types.types
        seconds, nanoseconds = divmod(stamp_ns, 10**9)
        stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
        header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="camera_depth_optical_frame")
        size = {"header": header, "height": HEIGHT, "width": WIDTH}
        if self._frames % 10 == 0:
            K = [FOCAL_PX, 0.0, 43.5, 0.0, FOCAL_PX, 35.5, 0.0, 0.0, 1.0]
            info = types["sensor_msgs/msg/CameraInfo"](
                **size,
                distortion_model="plumb_bob",
                d=np.zeros(5),
                k=np.array(K),
                r=np.eye(3).ravel(),
                p=np.zeros(12),
                binning_x=0,
                binning_y=0,
                roi=types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
            )
            self._put("camera/camera/depth/camera_info", info)
        for topic, image, encoding in zip(
            ("depth/image_rect_raw", "infra1/image_rect_raw"), pictures(), ("16UC1", "mono8"), strict=True
        ):
            padded = np.pad(image, ((0, 0), (0, 4)))  # rows may be longer than their pixels
            padded[0, -1] = self._frames % 250  # frames whose bytes repeat are refused as frozen
            data = padded.reshape(-1).view(np.uint8)
            message = types["sensor_msgs/msg/Image"](
                **size, encoding=encoding, is_bigendian=0, step=padded[0].nbytes, data=data
            )
            self._put(f"camera/camera/{topic}", message)
        self._frames += 1
        return stamp_ns

    def _put(self, topic, message):
        number = self._sequence[topic] = self._sequence.get(topic, -1) + 1  # the first is 0
        package, _, name = message.__msgtype__.split("/")
        digest = self._types.hash_rihs01(message.__msgtype__)
        self._session.put(
            f"0/{topic}/{package}::msg::dds_::{name}_/{digest}",
            bytes(self._types.serialize_cdr(message, message.__msgtype__)),
            attachment=struct.pack("<qqB", number, time.time_ns(), 16) + self._gid,
        )


def test_a_ros_camera_is_tracked_by_a_preset_and_a_mount(bus):
    listener, estimates = bus.node("listener"), Inbox()
    listener.subscribe(ESTIMATE, estimates.put, recover=True)
    document = {
        "target": "mockup",
        "sensors": [
            {
                "kind": "pmd",
                "name": "front",
                "source": {"preset": str(PRESET), "stamp": "start", "duration_s": EXPOSURE_S},
                "T_chaser_sensor": MOUNT,
            }
        ],
        "bus": {"connect": bus.endpoint},
    }
    estimator = check(EstimatorConfig, document, source="test")
    client = zenoh.Config.from_json5(f'{{mode: "client", connect: {{endpoints: ["{bus.endpoint}"]}}}}')
    stamps = set()
    with zenoh.open(client) as session, daemon(run, estimator):
        camera, found = RosCamera(session), None
        deadline_s = time.monotonic() + 3.0 * TIMEOUT_S
        while found is None and time.monotonic() < deadline_s:
            stamps.add(camera.expose())
            found = first(estimates, lambda received: read_odometry(received.decode()), 0.2)
    assert found is not None
    np.testing.assert_allclose(found.pose.translation, T_CHASER_TARGET.translation, atol=0.03)
    turned = found.pose.rotation * T_CHASER_TARGET.rotation.inv()
    assert np.degrees(turned.magnitude()) < 1.5
    assert found.stamp_ns - round(0.5 * EXPOSURE_S * 1e9) in stamps  # the middle of an exposure
