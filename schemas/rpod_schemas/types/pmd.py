"""Frames of a PMD camera, and what the camera says of itself."""

from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import field_validator, model_validator
from scipy.constants import speed_of_light

from rpod_schemas.arrays import VectorN
from rpod_schemas.bounds import (
    ELECTRONS_PER_COUNT,
    FREQUENCIES,
    INTEGRATION_TIME_S,
    MODULATION_FREQUENCY_HZ,
    SATURATION_COUNT,
    bounded,
)
from rpod_schemas.types.base import Float32Array, Floats, Image
from rpod_schemas.types.frames import Camera, FrameImage, SensorFrame, SensorInfo

_WRAPS = 10.0
"""Number of unambiguous ranges that several modulation frequencies may extend."""


class PmdInfo(SensorInfo):
    """Info of a PMD camera (PmdInfo.msg)."""

    modulation_frequency_hz: Annotated[VectorN, bounded(MODULATION_FREQUENCY_HZ)]
    """Modulation frequencies in the order of the phase images, Hz; empty if the camera does not state
    them."""
    integration_time_s: Annotated[float, bounded(INTEGRATION_TIME_S)]
    electrons_per_count: Annotated[float, bounded(ELECTRONS_PER_COUNT)]
    saturation_count: Annotated[float, bounded(SATURATION_COUNT)]

    @property
    def duration_s(self) -> float:
        """Duration of an exposure."""
        return self.integration_time_s

    @property
    def farthest_m(self) -> float:
        """Unambiguous range of the lowest frequency, and several of them with more frequencies, m."""
        if not self.modulation_frequency_hz.size:
            return super().farthest_m
        unambiguous_m = speed_of_light / (2.0 * float(self.modulation_frequency_hz.min()))
        return unambiguous_m * (_WRAPS if self.modulation_frequency_hz.size > 1 else 1.0)

    @field_validator("modulation_frequency_hz")
    @classmethod
    def _frequencies_are_few(cls, value: NDArray[np.float64]) -> NDArray[np.float64]:
        try:
            FREQUENCIES.check(value.size)
        except ValueError as error:
            raise ValueError(f"number {error}") from error
        return value


class PmdFrame(SensorFrame):
    """One exposure of a PMD camera; ``frame_id`` is the optical frame.

    It has a depth image always. A camera that sends amplitudes alone is of another kind, and one that sends
    raw samples alone needs a driver that makes depth of them.
    """

    depth_m: Floats
    """z-depth, m, shape (height, width); NaN for pixels without depth."""
    amplitude: Image | None = None
    """Received amplitude, shape (height, width), uint8, uint16 or float32; None if it was not sent."""
    camera: Camera
    info: PmdInfo | None = None
    """Info of the camera; None if it sends none."""
    saturated: Image | None = None
    """Pixels whose amplitude is saturated, so that it is at least what the image says and their depth is NaN,
    bool, shape (height, width); None if there are none."""
    depth_sigma_m: Image | None = None
    """Standard deviation of each pixel's depth as the camera states it, m, float32, shape (height, width);
    None if it states none."""
    hidden: Image | None = None
    """Pixels that do not show the target, because something else is there, bool, shape (height, width);
    None if no such thing is known."""

    @property
    def lens(self) -> Camera:
        """Camera that made the frame."""
        return self.camera

    @property
    def images(self) -> tuple[FrameImage, ...]:
        """Images of depth, and of amplitude if it was sent."""
        depth = FrameImage("depth", self.depth_m, "depth")
        return (
            (depth,) if self.amplitude is None else (depth, FrameImage("amplitude", self.amplitude, "grey"))
        )

    @property
    def range_image_m(self) -> Float32Array:
        """Z-depth of each pixel, m, shape (height, width), 0 without depth."""
        return np.where(self.depth_m > 0.0, self.depth_m, np.float32(0.0))

    @model_validator(mode="after")
    def _sizes_agree(self) -> Self:
        size = (self.camera.height, self.camera.width)
        if self.depth_m.shape != size:
            raise ValueError(f"depth image is {self.depth_m.shape}, camera_info says {size}")
        for name, image in (
            ("amplitude", self.amplitude),
            ("saturation", self.saturated),
            ("depth sigma", self.depth_sigma_m),
            ("hidden", self.hidden),
        ):
            if image is not None and image.shape != size:
                raise ValueError(f"{name} image is {image.shape}, camera_info says {size}")
        return self
