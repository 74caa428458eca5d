"""A cue that selects templates before they are cast: the covariance of the scan's points.

It follows a suggestion that Opromolla et al., Sensors 15(3), 2015, leave to future work (section 4): fewer
templates by properties of the point cloud itself. The covariance of the points, a symmetric matrix in sensor
axes, contains their extents with the directions. It is computed in advance for each attitude, from ideal
scans of the target on the boresight at a few ranges, since a target that fills the field of view shows only a
part of itself. The distance of two covariances A and B is the Frobenius norm of sqrt(A) - sqrt(B), a length.
The attitudes whose covariance is nearest to the scan's are kept.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.rays import RayGrid
from rpod_pose.lidar.paper_2015.correlation import cast_covariances
from rpod_schemas.arrays import FloatArray
from rpod_target import Target

AWAY = np.sqrt(2.0) ** np.arange(5)
"""Ranges of the ideal scans, in radii of the target: 1 to 4. Numerics: half of a factor of two apart, as the
cue changes slowly with the range."""


@dataclass(frozen=True, eq=False)
class CovarianceCue:
    """Covariances of ideal scans over a grid of attitudes."""

    ranges_m: FloatArray
    """Ranges of the ideal scans, shape (L,)."""
    spreads_m: FloatArray
    """Square roots of their covariances, sensor axes, shape (L, K, 3, 3); zero without returns."""

    @classmethod
    def of(cls, grid: RayGrid, target: Target, rotations: FloatArray) -> Self:
        """Return the cue of a scan pattern and of attitudes R_sensor_target, shape (K, 3, 3)."""
        ranges_m = AWAY * target.radius_m
        covariances = [
            cast_covariances(grid.arrays, target.triangles_m, rotations, np.array([0.0, 0.0, range_m]))
            for range_m in ranges_m
        ]
        return cls(ranges_m, _square_roots(np.stack(covariances)))

    def most_similar(self, points_m: FloatArray, which: NDArray[np.intp], share: float) -> NDArray[np.intp]:
        """Return the positions in ``which`` of the attitudes most similar to a scan, in their order.

        Args:
            points_m: points of the scan, shape (N, 3).
            which: indices of attitudes, shape (K,).
            share: share of the attitudes to keep; at least one is kept.
        """
        level = np.argmin(np.abs(self.ranges_m - np.linalg.norm(points_m.mean(axis=0))))
        spread_m = _square_roots(np.cov(points_m.T, bias=True))
        apart_m = np.linalg.norm(self.spreads_m[level, which] - spread_m, axis=(1, 2))
        count = max(1, round(share * which.size))
        return np.sort(np.argsort(apart_m, kind="stable")[:count])


def _square_roots(covariances: FloatArray) -> FloatArray:
    """Return the symmetric square roots of covariances, shape (..., 3, 3)."""
    values, vectors = np.linalg.eigh(covariances)
    roots: FloatArray = (vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]) @ vectors.swapaxes(-1, -2)
    return roots
