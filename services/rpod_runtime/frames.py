"""Decodes and checks the parts of a complete frame.

A reader stands for one sensor and remembers what the sensor says of itself. A kind names its reader; the ones
of the PMD camera and the LIDAR are here.
"""

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import numpy as np

from rpod_runtime.assembler import Assembled, Assembler
from rpod_runtime.inbox import Received
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import (
    build,
    read_amplitude,
    read_camera,
    read_depth,
    read_lidar_info,
    read_pmd_info,
    read_points,
)
from rpod_schemas.registry import resolve
from rpod_schemas.sensors import SensorKind
from rpod_schemas.types import Float32Array, LidarInfo, LidarScan, PmdFrame, PmdInfo, SensorFrame

ReadT = TypeVar("ReadT")


class SensorReader(Protocol):
    """Reads the messages of one sensor."""

    @property
    def said(self) -> Any:
        """What the sensor says of itself; None as long as it says nothing."""
        ...

    def learn(self, message: Any) -> None:
        """Take what the sensor says of itself, a decoded message. Raises ``MessageRejectedError``."""
        ...

    def read(self, frame: Assembled[Received]) -> SensorFrame:
        """Return a frame. Raises ``PartRejectedError``."""
        ...


def open_reader(kind: SensorKind) -> SensorReader:
    """Return a new reader of a kind."""
    reader: SensorReader = resolve(kind.reader)()
    return reader


def assembler_of(kind: SensorKind) -> Assembler[Received]:
    """Return an assembler of the frames of a kind (ICD section 2)."""
    return Assembler(kind.required, kind.optional)


class PartRejectedError(MessageRejectedError):
    """A part of a frame cannot be used; ``topic`` is the topic on which it came."""

    def __init__(self, received: Received, rejection: MessageRejectedError) -> None:
        super().__init__(rejection.reason, rejection.text)
        self.topic = received.topic.name


class PmdReader:
    """Frames of a PMD camera."""

    def __init__(self) -> None:
        self.said: PmdInfo | None = None

    def learn(self, message: Any) -> None:
        """Take the latched info."""
        self.said = read_pmd_info(message)

    def read(self, frame: Assembled[Received]) -> PmdFrame:
        """Return depth, amplitude where it was sent, camera, and what the camera says of itself."""
        amplitude = frame.parts.get("amplitude")
        camera = read_part(frame.parts["camera_info"], read_camera)
        size = (camera.height, camera.width)
        frame_id, depth_m = read_part(
            frame.parts["depth"],
            lambda message: (str(message.header.frame_id), sized(read_depth(message), size)),
        )
        return PmdFrame(
            stamp_ns=frame.stamp_ns,
            frame_id=frame_id,
            depth_m=depth_m,
            amplitude=read_part(amplitude, lambda message: sized(read_amplitude(message), size))
            if amplitude
            else None,
            camera=camera,
            info=self.said,
        )


class LidarReader:
    """Scans of a LIDAR, rows being elevation."""

    def __init__(self) -> None:
        self.said: LidarInfo | None = None

    def learn(self, message: Any) -> None:
        """Take the latched info; one without a scan pattern says nothing."""
        info = read_lidar_info(message)
        if info.azimuth_rad.size and info.elevation_rad.size:
            self.said = info

    def read(self, frame: Assembled[Received]) -> LidarScan:
        """Return a scan."""
        rows_are_elevation = self.said is None or self.said.rows_are_elevation

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

        return read_part(frame.parts["points"], read)


def read_part(received: Received, read: Callable[[Any], ReadT]) -> ReadT:
    """Return what ``read`` makes of a decoded part. Raises ``PartRejectedError`` where it is refused."""
    try:
        return read(received.decode())
    except MessageRejectedError as error:
        raise PartRejectedError(received, error) from error


def sized(image: Any, size: tuple[int, int]) -> Any:
    """Return an image whose shape is (height, width) as said. Raises ``MessageRejectedError`` for another."""
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
