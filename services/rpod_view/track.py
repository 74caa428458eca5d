"""Poses by stamp, interpolated between samples and predicted for a short time after the last one."""

from bisect import bisect_left
from itertools import islice

from scipy.spatial.transform import RigidTransform

from rpod_schemas.poses import between
from rpod_schemas.rmw.cdr import NANOSECONDS

_BASE_NS = 100_000_000
"""Time span from which the velocity for a prediction is computed; long enough not to amplify noise."""
_AGAIN_NS = 1_000_000_000
"""Time by which a stamp must precede the last one to start a new run."""


class Track:
    """The poses of the last seconds, ``T_chaser_target``.

    Args:
        gap_s: longest time between two poses over which a pose is interpolated.
        reach_s: longest time after the last pose for which a pose is predicted.
        kept: number of poses that are kept.
    """

    def __init__(self, *, gap_s: float, reach_s: float, kept: int = 512) -> None:
        self._gap_ns, self._reach_ns = round(gap_s * NANOSECONDS), round(reach_s * NANOSECONDS)
        self._kept = kept
        self._stamps_ns: list[int] = []
        self._poses: list[RigidTransform] = []

    @property
    def newest_ns(self) -> int:
        """Stamp of the last pose; -1 where there is none."""
        return self._stamps_ns[-1] if self._stamps_ns else -1

    def add(self, stamp_ns: int, pose: RigidTransform) -> None:
        """Add a pose; stamps that do not rise are ignored, unless a new run has started."""
        if stamp_ns < self.newest_ns - _AGAIN_NS:
            self._stamps_ns, self._poses = [], []
        if stamp_ns <= self.newest_ns:
            return
        self._stamps_ns.append(stamp_ns)
        self._poses.append(pose)
        if len(self._poses) > 2 * self._kept:
            del self._stamps_ns[: -self._kept], self._poses[: -self._kept]

    def at(self, stamp_ns: int) -> RigidTransform | None:
        """Return the pose at a stamp, interpolated or predicted with constant velocity; None if unknown."""
        after = bisect_left(self._stamps_ns, stamp_ns)
        if after < len(self._poses) and self._stamps_ns[after] == stamp_ns:
            return self._poses[after]
        if after == len(self._poses):
            return self._beyond(stamp_ns)
        if after == 0 or self._stamps_ns[after] - self._stamps_ns[after - 1] > self._gap_ns:
            return None
        return self._along(after - 1, after, stamp_ns)

    def _beyond(self, stamp_ns: int) -> RigidTransform | None:
        if len(self._poses) < 2 or stamp_ns - self.newest_ns > self._reach_ns:
            return None
        last = len(self._poses) - 1
        earlier = islice(range(last - 1, -1, -1), self._kept)
        first = next((k for k in earlier if self.newest_ns - self._stamps_ns[k] >= _BASE_NS), 0)
        if self.newest_ns - self._stamps_ns[first] > self._gap_ns + _BASE_NS:
            return None
        return self._along(first, last, stamp_ns)

    def _along(self, first: int, second: int, stamp_ns: int) -> RigidTransform:
        start_ns, end_ns = self._stamps_ns[first], self._stamps_ns[second]
        return between(self._poses[first], self._poses[second], (stamp_ns - start_ns) / (end_ns - start_ns))
