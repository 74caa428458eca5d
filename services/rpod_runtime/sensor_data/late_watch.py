"""Why a sensor's frames arrive late: they were delayed on their way, or their clock is behind.

One age alone does not tell. But the offset of a clock stays, while a delay varies. With a delay, earlier
frames of the same publisher came in time, their stamps kept their pace, and the time between two arrivals
grew by as much as the age. A clock that is set back, or runs slow, makes stamps too close, and arrivals stay
even.
"""

from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from statistics import median
from typing import NamedTuple

from rpod_schemas.messages import NANOSECONDS

_MOST = 1024
"""Frames that are kept: 20 s of a camera at 45 Hz, more than a link holds back."""
_HALF = 0.5
"""Share of a growth in age, or of a late frame's age, above which a cause explains it. Also the share of a
period below which the time between two stamps shows that the clock was set back."""
_PACE = 3
"""Number of arrivals from which on their pace is known."""
_LINK = "look at the link (range, loss, bandwidth; a camera's reduced rate needs less)"
_DRIVER = "look at the driver and at the load of its host"


class _Frame(NamedTuple):
    stamp_ns: int
    sent_ns: int
    """Time of sending by the clock of the publisher's host; 0 where it is not stated."""
    arrival_ns: int
    arrival_s: float
    """Time of arrival by the monotonic clock."""

    @property
    def age_s(self) -> float:
        return (self.arrival_ns - self.stamp_ns) / NANOSECONDS


class LateWatch:
    """Follows stamps and arrivals of one sensor's frames.

    Args:
        max_age_s: age from which on a frame is late.
    """

    def __init__(self, max_age_s: float) -> None:
        self._max_age_s = max_age_s
        self._frames: deque[_Frame] = deque(maxlen=_MOST)
        self._source: object = None

    def add(
        self, stamp_ns: int, arrival_ns: int, *, arrival_s: float, sent_ns: int = 0, source: object = None
    ) -> None:
        """Take a frame. Frames of another publisher start anew, since it has its own clock."""
        if source != self._source:
            self._frames.clear()
            self._source = source
        if not self._frames or stamp_ns != self._frames[-1].stamp_ns:
            self._frames.append(_Frame(stamp_ns, sent_ns, arrival_ns, arrival_s))

    def why(self) -> str:
        """Return why the last frame is late, with the remedy, if it was delayed on its way; else empty."""
        frames = list(self._frames)
        ages_s = [each.age_s for each in frames]
        in_time = [place for place, age_s in enumerate(ages_s) if abs(age_s) <= self._max_age_s]
        if in_time:
            youngest = min(reversed(in_time), key=ages_s.__getitem__)
            return _held(frames[youngest:], _pace_s(frames[: in_time[-1] + 1]) or _pace_s(frames))
        varies_s = max(ages_s, default=0.0) - min(ages_s, default=0.0)
        if varies_s <= _HALF * self._max_age_s or not _clocks_ran(frames, varies_s, _pace_s(frames)):
            return ""
        return (
            f"the age of its frames varies by {varies_s:.3f} s, as a delay does and an offset of a clock "
            f"does not: {_LINK}, and {_DRIVER}; then check the sensor's clock"
        )


def _held(frames: Sequence[_Frame], pace_s: float) -> str:
    """Return how the last frame was delayed against the first one; empty if it was not."""
    first, last = frames[0], frames[-1]
    held_s = last.age_s - first.age_s
    if held_s <= 0.0 or not _clocks_ran(frames, held_s, pace_s):
        return ""
    if held_s <= _HALF * last.age_s:
        return (
            f"the youngest of its frames were {first.age_s:.3f} s old: check the sensor's clock, or set "
            f"source.clock_offset_s of the sensor; another {held_s:.3f} s came on the way: {_LINK}, then "
            f"{_DRIVER}"
        )
    told = f"it was delayed by {held_s:.3f} s"
    clock = "its clock has not changed since frames came in time"
    if not (first.sent_ns and last.sent_ns):
        return f"{told} on the link or in the driver, {clock}; {_LINK}, then {_DRIVER}"
    sent_late_s = (last.sent_ns - last.stamp_ns - first.sent_ns + first.stamp_ns) / NANOSECONDS
    if sent_late_s > _HALF * held_s:
        return f"{told}, most of it before it was sent, {clock}; {_DRIVER}"
    return f"{told} on the link, {clock}; {_LINK}"


def _pace_s(frames: Sequence[_Frame]) -> float:
    """Return the median time from arrival to arrival, s; 0 if it is not known."""
    steps_s = [after.arrival_s - before.arrival_s for before, after in pairwise(frames)]
    return median(steps_s) if len(steps_s) >= _PACE else 0.0


def _clocks_ran(frames: Sequence[_Frame], varies_s: float, pace_s: float) -> bool:
    """Return whether both clocks went on while the age of frames varied: the sensor's and this machine's.

    Args:
        frames: the frames.
        varies_s: how far their ages vary, s.
        pace_s: usual time from arrival to arrival, s; 0 if it is not known.
    """
    steps_ns = [after.stamp_ns - before.stamp_ns for before, after in pairwise(frames)]
    if not steps_ns or min(steps_ns) <= _HALF * median(steps_ns):
        return False
    lost_s = len(steps_ns) * pace_s - sum(steps_ns) / NANOSECONDS
    host_s = (frames[-1].arrival_ns - frames[0].arrival_ns) / NANOSECONDS
    host_set_s = abs(host_s - (frames[-1].arrival_s - frames[0].arrival_s))
    return max(lost_s, host_set_s) <= _HALF * varies_s
