"""Scans of a LIDAR, and what the LIDAR says of itself."""

from typing import Annotated, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from rpod_schemas.arrays import VectorN
from rpod_schemas.bounds import (
    SCAN_DIRECTIONS,
    SCAN_TIME_S,
    SIGMA_RANGE_M,
    AzimuthsRad,
    ElevationsRad,
    bounded,
)
from rpod_schemas.types.base import Float32Array, Floats, Image
from rpod_schemas.types.frames import SensorFrame, SensorInfo


class LidarScan(SensorFrame):
    """One scan of a LIDAR."""

    taken_in: ClassVar[str] = "a scan"

    points_m: Floats
    """Points, m, shape (rows, columns, 3) if organised, else (N, 3); NaN for rays without a return,
    infinite for rays of which nothing is known."""
    intensity: Floats | None = None
    """Intensities, shape of ``points_m`` without its last axis."""
    time_s: Floats | None = None
    """Times from the stamp, s, shape of ``points_m`` without its last axis."""
    hidden: Image | None = None
    """Rays of the scan pattern that do not show the target, because a known body is there, bool, shape
    (rows, columns); None if no body is known."""

    @model_validator(mode="after")
    def _shapes_agree(self) -> Self:
        shape = self.points_m.shape
        if len(shape) not in (2, 3) or shape[-1] != 3:
            raise ValueError(f"points have shape {shape}, need (rows, columns, 3) or (N, 3)")
        for name in ("intensity", "time_s"):
            array = getattr(self, name)
            if array is not None and array.shape != shape[:-1]:
                raise ValueError(f"{name} has shape {array.shape}, need {shape[:-1]}")
        return self

    @property
    def lasting_s(self) -> float:
        """RMS time of the returns from the stamp, s; 0 without times."""
        if self.time_s is None or not self.time_s.any():
            return 0.0
        returned_s = self.time_s[self._returned]
        return float(np.sqrt(np.mean(returned_s**2))) if returned_s.size else 0.0

    @property
    def return_times_s(self) -> Float32Array | None:
        """Times of ``returns_m`` from the stamp, s, shape (N,), NaN where unknown; None without times."""
        return None if self.time_s is None else self.time_s[self._returned]

    @property
    def begins_s(self) -> float | None:
        """Time of the first ray from the stamp, s, with or without a return; None without times."""
        timed_s = () if self.time_s is None else self.time_s[np.isfinite(self.time_s)]
        return float(np.min(timed_s)) if len(timed_s) else None

    @property
    def organised(self) -> bool:
        """Whether rows and columns of the scan pattern are kept."""
        return self.points_m.ndim == 3

    @property
    def grid_m(self) -> Float32Array | None:
        """Points, m, shape (rows, columns, 3), NaN without a return; None if the scan is not organised."""
        return self.points_m if self.organised else None

    @property
    def range_image_m(self) -> Float32Array | None:
        """Range of each ray, m, shape (rows, columns), 0 without a return; None if not organised."""
        if not self.organised:
            return None
        range_m = np.linalg.norm(self.points_m, axis=-1)
        return np.where(np.isfinite(range_m), range_m, 0.0).astype(np.float32)

    @property
    def returns_m(self) -> Float32Array:
        """Points that are returns, m, shape (N, 3): finite, and not the origin, which means no return."""
        return self.points_m[self._returned]

    @property
    def _returned(self) -> NDArray[np.bool_]:
        return np.asarray(np.isfinite(self.points_m).all(axis=-1) & self.points_m.any(axis=-1))


class LidarInfo(SensorInfo):
    """Info of a LIDAR (LidarInfo.msg)."""

    azimuth_rad: AzimuthsRad
    """Azimuths of the scan pattern, rad; directions are (sin az cos el, sin el, cos az cos el)."""
    row_azimuth_rad: VectorN | None = None
    """Azimuth that each row adds to those of the columns, rad, shape (rows,), as points show it. No message
    has it."""
    elevation_rad: ElevationsRad
    scan_time_s: Annotated[float, bounded(SCAN_TIME_S)]
    rows_are_elevation: bool = True
    sigma_range_m: Annotated[float, bounded(SIGMA_RANGE_M)]

    @property
    def duration_s(self) -> float:
        """Duration of a scan."""
        return self.scan_time_s

    @model_validator(mode="after")
    def _directions_fit_into_memory(self) -> Self:
        try:
            SCAN_DIRECTIONS.check(self.azimuth_rad.size * self.elevation_rad.size)
        except ValueError as error:
            raise ValueError(f"number of azimuth_rad x elevation_rad {error}") from error
        return self
