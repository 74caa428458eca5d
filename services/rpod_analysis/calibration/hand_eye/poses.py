"""Stamped poses with covariances, and the same poses at other times."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rpod_analysis.scoring.score import BoolArray, IntArray
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import matrices_between, matrices_of


@dataclass(frozen=True, eq=False)
class StampedPoses:
    """Poses of one source over time, with their errors' covariances."""

    stamp_ns: IntArray
    """Stamps, rising, shape (N,)."""
    R: FloatArray
    """Rotation matrices, shape (N, 3, 3)."""
    t_m: FloatArray
    """Positions, shape (N, 3)."""
    covariance: FloatArray
    """Covariance of (dp, dtheta) in the fixed axes of the parent frame (ICD section 1), shape (N, 6, 6);
    zeros where it is not known."""

    def __len__(self) -> int:
        return self.stamp_ns.size

    @property
    def has_covariance(self) -> bool:
        """Whether every pose has a covariance."""
        return bool((np.diagonal(self.covariance, axis1=1, axis2=2) > 0.0).all())

    def at(self, where: BoolArray | NDArray[np.intp]) -> "StampedPoses":
        """Return some of the poses."""
        return StampedPoses(self.stamp_ns[where], self.R[where], self.t_m[where], self.covariance[where])

    def in_order(self) -> "StampedPoses":
        """Return the poses in the order of their stamps, the first of each stamp."""
        return self.at(np.unique(self.stamp_ns, return_index=True)[1])

    def gap_s(self, stamp_ns: IntArray, later_s: float) -> FloatArray:
        """Return the time between the poses around moved stamps, s; infinite beyond the ends, shape (M,)."""
        own_s = 1e-9 * (self.stamp_ns - self.stamp_ns[0])
        after = np.searchsorted(own_s, 1e-9 * (stamp_ns - self.stamp_ns[0]) + later_s)
        inside = (after > 0) & (after < len(self))
        after = after.clip(1, len(self) - 1)
        return np.where(inside, own_s[after] - own_s[after - 1], np.inf).astype(np.float64)


class Interpolated:
    """Poses at any time: positions linear between neighbours, attitudes on the shortest arc."""

    def __init__(self, poses: StampedPoses) -> None:
        self._poses = poses
        self._origin_ns = int(poses.stamp_ns[0])
        self._time_s = 1e-9 * (poses.stamp_ns - self._origin_ns)
        self._matrices = matrices_of(poses.R, poses.t_m)

    def at(self, stamp_ns: IntArray, later_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return rotation matrices, (M, 3, 3), and positions, (M, 3), at stamps moved by times, (M,) each."""
        before, share = self._place(stamp_ns, later_s)
        matrices = matrices_between(self._matrices[before], self._matrices[before + 1], share)
        return matrices[:, :3, :3], matrices[:, :3, 3]

    def covariance_at(self, stamp_ns: IntArray, later_s: FloatArray) -> FloatArray:
        """Return the covariances, shape (M, 6, 6), as if the errors of neighbours were the same."""
        before, share = self._place(stamp_ns, later_s)
        share, known = share[:, None, None], self._poses.covariance
        mixed: FloatArray = (1.0 - share) * known[before] + share * known[before + 1]
        return mixed

    def _place(self, stamp_ns: IntArray, later_s: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
        time_s = 1e-9 * (stamp_ns - self._origin_ns) + later_s
        before = (np.searchsorted(self._time_s, time_s) - 1).clip(0, self._time_s.size - 2)
        step_s = self._time_s[before + 1] - self._time_s[before]
        return before, (time_s - self._time_s[before]) / step_s
