"""Decodes and checks the parts of a complete frame."""

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import numpy as np

from rpod_runtime.assembler import Assembled, Assembler
from rpod_runtime.inbox import Received
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import build, read_amplitude, read_camera, read_depth, read_points
from rpod_schemas.topics import AMPLITUDE, CAMERA_INFO, DEPTH, POINTS
from rpod_schemas.types import Float32Array, LidarScan, PmdFrame, PmdInfo

ReadT = TypeVar("ReadT")

CAMERA_PARTS = {"depth": DEPTH, "camera_info": CAMERA_INFO, "amplitude": AMPLITUDE}
"""Topics of the parts of a camera frame, by part."""
LIDAR_PARTS = {"points": POINTS}
"""Topics of the parts of a LIDAR frame, by part."""
_OPTIONAL = frozenset({"amplitude"})


def assembler_of(parts: Iterable[str]) -> Assembler[Received]:
    """Return an assembler of a sensor's parts (ICD section 2): depth and camera_info are required."""
    names = frozenset(parts)
    return Assembler(names - _OPTIONAL, names & _OPTIONAL)


class PartRejectedError(MessageRejectedError):
    """A part of a frame cannot be used; ``topic`` is the topic on which it came."""

    def __init__(self, received: Received, rejection: MessageRejectedError) -> None:
        super().__init__(rejection.reason, rejection.text)
        self.topic = received.topic.name


def read_frame(frame: Assembled[Received], info: PmdInfo | None = None) -> PmdFrame:
    """Return a decoded camera frame with the camera's info. Raises ``PartRejectedError``."""
    depth, amplitude = frame.parts["depth"], frame.parts.get("amplitude")
    camera = _read(frame.parts["camera_info"], read_camera)
    size = (camera.height, camera.width)
    frame_id, depth_m = _read(
        depth, lambda message: (str(message.header.frame_id), _sized(read_depth(message), size))
    )
    return PmdFrame(
        stamp_ns=frame.stamp_ns,
        frame_id=frame_id,
        depth_m=depth_m,
        amplitude=_read(amplitude, lambda message: _sized(read_amplitude(message), size))
        if amplitude
        else None,
        camera=camera,
        info=info,
    )


def read_scan(frame: Assembled[Received], *, rows_are_elevation: bool = True) -> LidarScan:
    """Return a decoded scan whose rows are elevation. Raises ``PartRejectedError``."""

    def read(message: Any) -> LidarScan:
        fields = read_points(message)
        if not rows_are_elevation:
            fields = {name: values.T for name, values in fields.items()}
        return build(
            LidarScan,
            stamp_ns=frame.stamp_ns,
            frame_id=message.header.frame_id,
            points_m=_finite(np.stack([fields["x"], fields["y"], fields["z"]], axis=-1)),
            intensity=fields.get("intensity"),
            time_s=fields.get("t"),
        )

    return _read(frame.parts["points"], read)


def _read(received: Received, read: Callable[[Any], ReadT]) -> ReadT:
    try:
        return read(received.decode())
    except MessageRejectedError as error:
        raise PartRejectedError(received, error) from error


def _sized(image: Any, size: tuple[int, int]) -> Any:
    if image.shape != size:
        raise MessageRejectedError(
            Reason.WRONG_SIZE,
            f"image of {image.shape[1]} x {image.shape[0]}, camera_info says {size[1]} x {size[0]}",
        )
    return image


def _finite(points_m: Float32Array) -> Float32Array:
    if not np.isfinite(points_m).all(axis=-1).any():
        raise MessageRejectedError(Reason.NOT_FINITE, "no finite point in the cloud")
    return points_m
