"""Scan pattern of a LIDAR: the directions of its rays, and the errors that it states."""

from dataclasses import dataclass

import numpy as np

from rpod_geometry.rays import RayGrid
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import LidarInfo

UNKNOWN_SIGMA_M = 0.05
"""Sigma of a range if the sensor does not state it. Hand: pulsed LIDARs have errors of 2 to 5 cm."""


@dataclass(frozen=True, eq=False)
class ScanPattern:
    """Directions of an organised scan, and the range error that the sensor states."""

    azimuth_rad: FloatArray
    """Azimuths of the columns, shape (columns,)."""
    elevation_rad: FloatArray
    """Elevations of the rows, shape (rows,)."""
    sigma_range_m: float = 0.0
    """Standard deviation of a range; 0 if the sensor does not state it."""
    row_azimuth_rad: FloatArray | None = None
    """Azimuth that is added in each row to those of the columns, shape (rows,); None if it is 0."""

    @property
    def assumed_sigma_m(self) -> float:
        """Standard deviation of a range: the stated one, otherwise that of an unknown sensor."""
        return self.sigma_range_m or UNKNOWN_SIGMA_M

    @property
    def grid(self) -> RayGrid:
        """Rays of the pattern, shape (rows, columns)."""
        return RayGrid.azimuth_elevation(self.azimuth_rad, self.elevation_rad, self.row_azimuth_rad)

    @classmethod
    def of(cls, info: LidarInfo) -> "ScanPattern":
        """Return the scan pattern of a LIDAR's info message."""
        return cls(info.azimuth_rad, info.elevation_rad, info.sigma_range_m, info.row_azimuth_rad)

    def __eq__(self, other: object) -> bool:
        """Return whether two patterns have the same directions and the same noise."""
        if not isinstance(other, ScanPattern):
            return NotImplemented
        return (
            np.array_equal(self.azimuth_rad, other.azimuth_rad)
            and np.array_equal(self.elevation_rad, other.elevation_rad)
            and _same(self.row_azimuth_rad, other.row_azimuth_rad)
            and self.sigma_range_m == other.sigma_range_m
        )

    __hash__ = None  # type: ignore[assignment]

    def __str__(self) -> str:
        """Return a short text with the pattern's size."""
        return f"scan pattern of {self.elevation_rad.size} x {self.azimuth_rad.size}"


def _same(one: FloatArray | None, other: FloatArray | None) -> bool:
    if one is None or other is None:
        return one is other
    return np.array_equal(one, other)
