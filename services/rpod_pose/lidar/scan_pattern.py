"""The directions of a LIDAR's rays."""

from dataclasses import dataclass

import numpy as np

from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import LidarInfo


@dataclass(frozen=True, eq=False)
class ScanPattern:
    """Directions of an organised scan."""

    azimuth_rad: FloatArray
    elevation_rad: FloatArray
    rows_are_elevation: bool = True
    """Of the scans as they are sent."""

    @classmethod
    def of(cls, info: LidarInfo) -> "ScanPattern":
        """Return what a LIDAR says of itself."""
        return cls(info.azimuth_rad, info.elevation_rad, info.rows_are_elevation)

    def equals(self, other: "ScanPattern") -> bool:
        """Return whether two patterns are the same."""
        return np.array_equal(self.azimuth_rad, other.azimuth_rad) and np.array_equal(
            self.elevation_rad, other.elevation_rad
        )
