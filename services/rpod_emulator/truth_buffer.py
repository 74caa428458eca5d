"""Buffer of the last seconds of truth, with interpolated poses."""

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, field

from scipy.spatial.transform import RigidTransform

from rpod_emulator.errors import TruthGapError
from rpod_runtime import Received
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import NANOSECONDS, read_pose
from rpod_schemas.poses import between
from rpod_schemas.rmw.cdr import peek_stamp

MAX_GAP_S = 0.008
"""Longest time between two samples of truth between which a pose is interpolated (ICD section 1)."""

_MAX_AHEAD_NS = NANOSECONDS


@dataclass
class TruthBuffer:
    """Truth in the order of its stamps; messages are decoded on arrival, which saves time later."""

    keep_s: float = 3.0
    _stamps_ns: deque[int] = field(default_factory=deque)
    _poses: deque[RigidTransform] = field(default_factory=deque)

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
        self._poses.append(read_pose(received.decode().pose.pose))
        self._stamps_ns.append(stamp_ns)
        while stamp_ns - self._stamps_ns[0] > self.keep_s * NANOSECONDS:
            self._stamps_ns.popleft()
            self._poses.popleft()

    def pose(self, stamp_ns: int) -> RigidTransform:
        """Return T_chaser_target at a stamp: linear in position, spherical in attitude.

        Raises:
            TruthGapError: the samples around the stamp are too far apart, or missing.
        """
        after = bisect_left(self._stamps_ns, stamp_ns)
        if after < len(self._stamps_ns) and self._stamps_ns[after] == stamp_ns:
            return self._poses[after]
        if not 0 < after < len(self._stamps_ns):
            raise TruthGapError(stamp_ns, MAX_GAP_S)
        before_ns, after_ns = self._stamps_ns[after - 1], self._stamps_ns[after]
        if after_ns - before_ns > MAX_GAP_S * NANOSECONDS:
            raise TruthGapError(stamp_ns, (after_ns - before_ns) / NANOSECONDS)
        share = (stamp_ns - before_ns) / (after_ns - before_ns)
        return between(self._poses[after - 1], self._poses[after], share)
