"""Buffer of the last seconds of truth, with interpolated poses."""

from bisect import bisect_left
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_emulator.errors import TruthGapError
from rpod_runtime import Received
from rpod_schemas.arrays import FloatArray
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import NANOSECONDS, read_place
from rpod_schemas.poses import matrices_between, matrices_of
from rpod_schemas.rmw.cdr import peek_stamp

MAX_GAP_S = 0.008
"""Longest time between two samples of truth between which a pose is interpolated (ICD section 1)."""

_MAX_AHEAD_NS = NANOSECONDS


@dataclass
class TruthBuffer:
    """Truth in the order of its stamps; messages are decoded on arrival, which saves time later."""

    keep_s: float = 3.0
    _stamps_ns: deque[int] = field(default_factory=deque)
    _places: deque[list[float]] = field(default_factory=deque)
    """Quaternion x, y, z, w and translation of each sample, m."""

    @property
    def first_ns(self) -> int | None:
        """Stamp of the oldest sample."""
        return self._stamps_ns[0] if self._stamps_ns else None

    @property
    def last_ns(self) -> int:
        """Stamp of the newest sample; -1 where there is none."""
        return self._stamps_ns[-1] if self._stamps_ns else -1

    def add(self, received: Received, *, latest_ns: int | None = None) -> None:
        """Add a message.

        Raises:
            MessageRejectedError: its stamp is not newer than that of the message before, or more than a
                second after ``latest_ns``, which would make all later messages look old; or it cannot be
                decoded.
        """
        stamp_ns = peek_stamp(received.payload)
        if stamp_ns <= self.last_ns:
            raise MessageRejectedError(
                Reason.LATE, f"truth of {stamp_ns} ns, not newer than {self.last_ns} ns"
            )
        if latest_ns is not None and stamp_ns > latest_ns + _MAX_AHEAD_NS:
            ahead_s = (stamp_ns - latest_ns) / NANOSECONDS
            raise MessageRejectedError(Reason.FUTURE, f"truth is {ahead_s:.3f} s ahead of its arrival")
        self._places.append(read_place(received.decode().pose.pose))
        self._stamps_ns.append(stamp_ns)
        while stamp_ns - self._stamps_ns[0] > self.keep_s * NANOSECONDS:
            self._stamps_ns.popleft()
            self._places.popleft()

    def poses(
        self, stamps_ns: Sequence[int], T_sensor_chaser: RigidTransform | None = None
    ) -> list[RigidTransform]:
        """Return T_chaser_target at stamps, or T_sensor_target: linear in position, spherical in attitude.

        All at once, since for each array the overhead of SciPy is larger than the computation.

        Raises:
            TruthGapError: the samples around a stamp are too far apart, or missing.
        """
        around = [self._around(stamp_ns) for stamp_ns in stamps_ns]
        first = self._matrices([before for before, _, _ in around])
        second = self._matrices([after for _, after, _ in around])
        matrices = matrices_between(first, second, np.array([share for _, _, share in around]))
        if T_sensor_chaser is not None:
            matrices = T_sensor_chaser.as_matrix() @ matrices
        return list(RigidTransform(matrices, normalize=False, copy=False))

    def _matrices(self, samples: Sequence[int]) -> FloatArray:
        places = np.array([self._places[each] for each in samples])
        return matrices_of(Rotation.from_quat(places[:, :4]).as_matrix(), places[:, 4:])

    def _around(self, stamp_ns: int) -> tuple[int, int, float]:
        """Return the samples before and after a stamp, and its share of the way between them."""
        after = bisect_left(self._stamps_ns, stamp_ns)
        if after < len(self._stamps_ns) and self._stamps_ns[after] == stamp_ns:
            return after, after, 0.0
        if not 0 < after < len(self._stamps_ns):
            raise TruthGapError(stamp_ns, MAX_GAP_S)
        before_ns, after_ns = self._stamps_ns[after - 1], self._stamps_ns[after]
        if after_ns - before_ns > MAX_GAP_S * NANOSECONDS:
            raise TruthGapError(stamp_ns, (after_ns - before_ns) / NANOSECONDS)
        return after - 1, after, (stamp_ns - before_ns) / (after_ns - before_ns)
