"""Publishers of a camera and of a LIDAR, used by every driver and by the emulator (ICD section 2).

A sensor announces itself once, with its latched info and its mount. Its frames follow; all parts of a
frame carry the same stamp. The publisher sets the frame of reference and ignores a given ``frame_id``. A
sensor kind names its publisher; the publishers of the PMD camera and the LIDAR are here.
"""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_runtime.delivery.publisher import Publisher
from rpod_runtime.node import Node
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import (
    write_camera,
    write_image,
    write_lidar_info,
    write_pmd_info,
    write_points,
    write_transforms,
)
from rpod_schemas.registry import resolve
from rpod_schemas.sensors import sensor_kind
from rpod_schemas.topics import (
    AMPLITUDE,
    CAMERA_INFO,
    CHASER,
    DEPTH,
    DEPTH_SIGMA,
    LIDAR_INFO,
    PHASE,
    PMD_INFO,
    POINTS,
    TF_STATIC,
    optical_frame,
)
from rpod_schemas.types import LidarInfo, LidarScan, PmdFrame, PmdInfo

_AMPLITUDE_ENCODING = {"uint8": "mono8", "uint16": "mono16", "float32": "32FC1"}


class SensorPublisher(Protocol):
    """A sensor on the bus, created as ``(node, name, *, T_chaser_sensor)``. It lives as long as the node."""

    frame_type: type[Any]
    """Type of the frames that ``publish`` accepts."""
    info_type: type[Any] | None
    """Type of the info that ``announce`` accepts; None for a kind of sensor without info."""

    def announce(self, info: Any) -> None:
        """Publish the sensor's info, latched."""
        ...

    def publish(self, frame: Any) -> None:
        """Publish a frame. Raises ``MessageRejectedError`` if no message can hold it."""
        ...


def open_publisher(node: Node, kind: str, name: str, T_chaser_sensor: RigidTransform) -> SensorPublisher:
    """Return the publisher of a sensor of the given kind, after announcing the sensor's mount."""
    publisher: SensorPublisher = resolve(sensor_kind(kind).publisher)(
        node, name, T_chaser_sensor=T_chaser_sensor
    )
    return publisher


class CameraPublisher:
    """Publishes as a PMD camera. It announces itself when created and lives as long as the node."""

    frame_type, info_type = PmdFrame, PmdInfo

    def __init__(
        self, node: Node, name: str, *, T_chaser_sensor: RigidTransform, info: PmdInfo | None = None
    ) -> None:
        self.frame_id = optical_frame(name)
        self._node, self._name = node, name
        self._info: Publisher | None = None
        self._phase: Publisher | None = None
        self._depth_sigma: Publisher | None = None
        announce_mount(node, self.frame_id, T_chaser_sensor)
        if info is not None:
            self.announce(info)
        self._camera_info = node.publisher(CAMERA_INFO.of(name))
        self._depth = node.publisher(DEPTH.of(name))
        self._amplitude = node.publisher(AMPLITUDE.of(name))

    def announce(self, info: PmdInfo) -> None:
        """Publish the latched info: at the start, and again when it has changed."""
        self._info = self._info or self._node.publisher(PMD_INFO.of(self._name))
        self._info.publish(write_pmd_info(self._node.clock.now_ns(), self.frame_id, info))

    def publish(self, frame: PmdFrame, samples: NDArray[np.uint16] | None = None) -> None:
        """Publish a frame: camera_info, depth, amplitude and sigma where there are any, raw samples if given.

        Args:
            frame: one exposure.
            samples: Q1..Q4 with offset 32768, shape (height, width, 4), or (frequencies, height, width,
                4) in the order of the info.

        Raises:
            MessageRejectedError: the amplitude has a data type for which there is no image encoding.
        """
        encoding = "" if frame.amplitude is None else _amplitude_encoding(frame.amplitude)
        self._camera_info.publish(write_camera(frame.stamp_ns, self.frame_id, frame.camera))
        self._image(self._depth, frame.stamp_ns, frame.depth_m, "32FC1")
        if frame.amplitude is not None:
            self._image(self._amplitude, frame.stamp_ns, frame.amplitude, encoding)
        if frame.depth_sigma_m is not None:
            self._depth_sigma = self._depth_sigma or self._node.publisher(DEPTH_SIGMA.of(self._name))
            self._image(self._depth_sigma, frame.stamp_ns, frame.depth_sigma_m.astype(np.float32), "32FC1")
        if samples is not None:
            self._phase = self._phase or self._node.publisher(PHASE.of(self._name))
            for image in samples.reshape(-1, *samples.shape[-3:]):
                self._image(self._phase, frame.stamp_ns, image, "16UC4")

    def _image(self, publisher: Publisher, stamp_ns: int, image: NDArray[np.generic], encoding: str) -> None:
        publisher.publish(write_image(stamp_ns, self.frame_id, np.ascontiguousarray(image), encoding))


class LidarPublisher:
    """Publishes as a LIDAR. It announces itself when created and lives as long as the node."""

    frame_type, info_type = LidarScan, LidarInfo

    def __init__(
        self, node: Node, name: str, *, T_chaser_sensor: RigidTransform, info: LidarInfo | None = None
    ) -> None:
        self.frame_id = name
        self._node, self._name = node, name
        self._info: Publisher | None = None
        announce_mount(node, self.frame_id, T_chaser_sensor)
        if info is not None:
            self.announce(info)
        self._points = node.publisher(POINTS.of(name))

    def announce(self, info: LidarInfo) -> None:
        """Publish the latched info: at the start, and again when it has changed."""
        self._info = self._info or self._node.publisher(LIDAR_INFO.of(self._name))
        self._info.publish(write_lidar_info(self._node.clock.now_ns(), self.frame_id, info))

    def publish(self, scan: LidarScan) -> None:
        """Publish a scan. An organised scan keeps its rows and columns."""
        x_m, y_m, z_m = np.moveaxis(scan.points_m, -1, 0)
        intensity = np.zeros_like(x_m) if scan.intensity is None else scan.intensity
        fields = {"x": x_m, "y": y_m, "z": z_m, "intensity": intensity}
        if scan.time_s is not None:
            fields["t"] = scan.time_s
        self._points.publish(write_points(scan.stamp_ns, self.frame_id, fields))


def announce_mount(node: Node, frame_id: str, T_chaser_sensor: RigidTransform) -> None:
    """Publish the mount of a sensor, latched."""
    mount = (CHASER, frame_id, T_chaser_sensor)
    node.publisher(TF_STATIC).publish(write_transforms(node.clock.now_ns(), [mount]))


def _amplitude_encoding(amplitude: NDArray[np.generic]) -> str:
    try:
        return _AMPLITUDE_ENCODING[amplitude.dtype.name]
    except KeyError:
        known = ", ".join(_AMPLITUDE_ENCODING)
        text = f"amplitude has data type {amplitude.dtype.name}; convert it to one of {known}"
        raise MessageRejectedError(Reason.WRONG_TYPE, text) from None
