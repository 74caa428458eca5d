"""Frames of sensors of any kind, and the pinhole camera that made one."""

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from rpod_schemas.arrays import VectorN
from rpod_schemas.bounds import (
    DISTORTION,
    FOCAL_LENGTH_PX,
    IMAGE_PIXELS,
    IMAGE_SIDE,
    PRINCIPAL_POINT_PX,
    bounded,
)
from rpod_schemas.types.base import Float32Array, Model, Stamped

LENS_COEFFICIENTS = 8
"""Number of distortion coefficients of a rational_polynomial lens; plumb_bob has the first five."""


class Camera(Model):
    """Pinhole intrinsics and a lens that distorts; pixel centres at integers (ICD section 1)."""

    width: Annotated[int, bounded(IMAGE_SIDE)]
    height: Annotated[int, bounded(IMAGE_SIDE)]
    fx: Annotated[float, bounded(FOCAL_LENGTH_PX)]
    fy: Annotated[float, bounded(FOCAL_LENGTH_PX)]
    cx: Annotated[float, bounded(PRINCIPAL_POINT_PX)]
    cy: Annotated[float, bounded(PRINCIPAL_POINT_PX)]
    distortion: Annotated[VectorN, bounded(DISTORTION)] = Field(default_factory=lambda: np.zeros(5))
    """Distortion coefficients k1, k2, p1, p2, k3 of plumb_bob, shape (5,), or these and k4, k5, k6 of
    rational_polynomial, shape (8,)."""

    @model_validator(mode="after")
    def _fits_into_memory(self) -> Self:
        try:
            IMAGE_PIXELS.check(self.width * self.height)
        except ValueError as error:
            raise ValueError(f"width x height {error}") from error
        return self

    @property
    def coefficients(self) -> NDArray[np.float64]:
        """Distortion coefficients k1, k2, p1, p2, k3, k4, k5, k6, shape (8,)."""
        return np.append(self.distortion, np.zeros(LENS_COEFFICIENTS))[:LENS_COEFFICIENTS]

    @property
    def K(self) -> NDArray[np.float64]:  # noqa: N802 - the camera matrix's name
        """Camera matrix, shape (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class FrameImage:
    """An image of a frame, for reports and views."""

    title: str
    """Title, as ``depth``."""
    values: NDArray[Any]
    """Pixels, shape (height, width); NaN for pixels without a value."""
    scale: Literal["depth", "grey"]
    """Unit of the pixels: metres along the boresight, or brightness in any unit."""


class SensorFrame(Stamped):
    """One frame of a sensor of any kind; a kind adds its data, and their images and points for display."""

    taken_in: ClassVar[str] = "an exposure"
    """What makes a frame, with its article, as in "the end of an exposure"."""

    @property
    def lasting_s(self) -> float:
        """RMS time of what was measured from the stamp, s; 0 for a frame that is measured at once."""
        return 0.0

    @property
    def lens(self) -> Camera | None:
        """Camera that made the frame; None if no camera did."""
        return None

    @property
    def images(self) -> tuple[FrameImage, ...]:
        """Images for reports and views, the most informative first."""
        return ()

    @property
    def returns_m(self) -> Float32Array:
        """Points for display, sensor axes, shape (N, 3), m."""
        return np.zeros((0, 3), np.float32)

    @property
    def return_times_s(self) -> Float32Array | None:
        """Times of ``returns_m`` from the stamp, s, shape (N,), NaN where unknown; None without any."""
        return None

    @property
    def begins_s(self) -> float | None:
        """Time from the stamp of the first ray or pixel whose time is known, s; None without one."""
        return None

    @property
    def grid_m(self) -> Float32Array | None:
        """Points by row and column of the scan pattern, m, shape (rows, columns, 3); None without one."""
        return None

    @property
    def range_image_m(self) -> Float32Array | None:
        """Distance of each pixel or ray, m, shape (rows, columns), 0 where there is none; None without one.

        That of a camera's pixel is its z-depth.
        """
        return None


class SensorInfo(Model):
    """Info message of a sensor, in which it describes itself; a kind adds its data."""

    @property
    def duration_s(self) -> float:
        """Duration of an exposure or a scan, s; 0 if the sensor does not state it."""
        return 0.0

    @property
    def farthest_m(self) -> float:
        """Largest distance that the sensor can measure by its settings, m; inf if they limit none."""
        return float("inf")
