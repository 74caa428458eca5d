"""Image of the squared angles to the nearest return, from which the energies of a scan are computed."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from rpod_pose.lidar.scan_view import ScanView, SeenScan, spacing_rad
from rpod_pose.search.energy import CELLS, Image
from rpod_schemas.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class ReturnDistances:
    """Geometry of the image of squared angles between any direction and the nearest ray with a return.

    The image has equal steps in tan(azimuth) = x/z and tan(elevation) = y/hypot(x, z), so that points are
    projected without trigonometric functions.
    """

    view: ScanView
    columns: NDArray[np.intp]
    """Column of the pattern nearest to each column of the image."""
    rows: NDArray[np.intp]
    """Row of the pattern nearest to each row of the image."""
    low: tuple[float, float]
    """First edge of the image's columns and of its rows, as tangents."""
    step: tuple[float, float]
    """Width of a column and height of a row, as tangents."""

    @classmethod
    def of(cls, view: ScanView) -> "ReturnDistances":
        """Return the image's geometry for a pattern."""
        axes = [_axis(view.azimuth_rad), _axis(view.elevation_rad)]
        (columns, u0, du), (rows, v0, dv) = axes
        return cls(view, columns, rows, (u0, v0), (du, dv))

    def image(self, seen: SeenScan) -> Image:
        """Return the image of the squared angles to the returns of a scan."""
        sampling = spacing_rad(self.view.elevation_rad), spacing_rad(self.view.azimuth_rad)
        distance_rad = distance_transform_edt(seen.range_m == 0.0, sampling=sampling)
        squares = (distance_rad**2)[np.ix_(self.rows, self.columns)].astype(np.float32)
        return Image(squares, self.low[0], self.step[0], self.low[1], self.step[1])


def _axis(angles_rad: FloatArray) -> tuple[NDArray[np.intp], float, float]:
    half = spacing_rad(angles_rad) / 2.0
    low, high = np.tan(angles_rad.min() - half), np.tan(angles_rad.max() + half)
    step = (high - low) / CELLS
    middle = np.arctan(low + (np.arange(CELLS) + 0.5) * step)
    return np.abs(middle[:, None] - angles_rad).argmin(axis=1), float(low), float(step)
