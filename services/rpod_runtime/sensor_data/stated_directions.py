"""Comparison of the directions of a scan's points with those that the LIDAR's info states."""

from typing import NamedTuple

import numpy as np

from rpod_runtime.sensor_data.scan_grid import angles_of
from rpod_schemas.types import Float32Array, LidarInfo

SIGNS = "azimuths count to the right, and elevations downwards (x right, y down, z along the boresight)"
"""Signs of a pattern's directions (ICD section 3), for operators."""
_LEAST = 20
"""Least number of returns that are compared."""


class Compared(NamedTuple):
    """Angles of the returns beside the stated ones, of the rows or of the columns."""

    name: str
    """``azimuth`` or ``elevation``."""
    slope: float
    """Change of the measured angle over that of the stated one; 1 if both are alike, below 0 if reversed."""
    offset_steps: float
    """Median of the differences, in angles from one row or column to the next."""


def compared_directions(points_m: Float32Array, info: LidarInfo) -> list[Compared]:
    """Return how a scan's directions compare with the stated ones; a single row or column is left out.

    Args:
        points_m: points of a scan, shape (rows, columns, 3), rows being elevations, as many as the info has.
        info: the stated directions.
    """
    azimuth, elevation, returned = angles_of(points_m)
    if np.count_nonzero(returned) < _LEAST:
        return []
    found = []
    for name, seen_rad, stated_rad in (
        ("azimuth", azimuth, info.azimuth_rad[None]),
        ("elevation", elevation, info.elevation_rad[:, None]),
    ):
        if stated_rad.size < 2:
            continue
        stated = np.broadcast_to(stated_rad, seen_rad.shape)[returned]
        aside = np.angle(np.exp(1j * (seen_rad[returned] - stated)))
        slope = 1.0 + float(np.polyfit(stated - stated.mean(), aside, 1)[0]) if np.ptp(stated) else 1.0
        step = float(np.median(np.abs(np.diff(stated_rad.ravel()))))
        found.append(Compared(name, slope, float(np.median(aside)) / step))
    return found
