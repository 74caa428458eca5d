"""Whether the frames of a sensor arrive after they were measured, and not long after.

The time from a frame's last measurement to its arrival is read-out, driver and link, plus the offset of the
clocks. The first three are never negative. So a frame that arrives before its last measurement proves that
its stamp is late by at least the difference. A time that is always long proves nothing, since a driver may be
slow; it tells how early the stamps may be at most. It counts from the latest end that the exposure or scan
may have had: rays that met nothing are measured too.
"""

from collections import deque
from itertools import pairwise
from statistics import median
from typing import NamedTuple

import numpy as np

from rpod_runtime.sensor_data.drift_watch import CLOCK_SIGMAS
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.types import SensorFrame

_SECONDS = 5
_LEAST_SECONDS = 3
_LONG = 2.0
"""Span of the times of a scan's points, over the scan's duration or period, above which their unit is wrong:
units differ by 1000, and a stated duration may be that of another mode."""


class Last(NamedTuple):
    """The last measurement of a frame that is certain to be in it, and the end of its exposure or scan."""

    after_s: float
    """Time from the stamp to the last measurement, s."""
    what: str
    """Name of this measurement, in words."""
    begins_s: float | None = None
    """Latest time from the stamp at which the scan began, s; None if its points do not tell."""
    lasts_s: float = 0.0
    """Stated duration of exposure or scan, s; 0 if it is not stated."""

    def is_longer_than_a_scan(self, period_s: float) -> bool:
        """Return whether the points' times span clearly more than a scan can last: they have another unit."""
        if self.begins_s is None:
            return False
        return self.after_s - self.begins_s > _LONG * min(self.lasts_s or period_s, period_s)

    def ends_s(self, period_s: float) -> float:
        """Return the latest end of exposure or scan after the stamp, s; none lasts longer than a period."""
        lasts_s = self.lasts_s or period_s
        return max(self.after_s, 0.5 * lasts_s if self.begins_s is None else self.begins_s + lasts_s)


def last_of(data: SensorFrame, duration_s: float) -> Last:
    """Return a frame's last measurement.

    Args:
        data: the frame.
        duration_s: duration of the exposure or scan as it is stated, s; 0 if it is not.
    """
    returned_s = data.return_times_s
    if returned_s is not None and np.isfinite(returned_s).any():
        return Last(float(np.nanmax(returned_s)), "their last point", data.begins_s, duration_s)
    if duration_s > 0.0:
        end = f"the end of {data.taken_in} of {duration_s:.3f} s"
        return Last(0.5 * duration_s, end, None, duration_s)
    return Last(0.0, f"their stamp, the middle of {data.taken_in}")


class Finding(NamedTuple):
    """A contradiction between stamps and arrivals."""

    fault: str
    """Name in the catalogue of faults."""
    text: str
    """Figures and remedies, for the operator."""


class _Least(NamedTuple):
    """Least times of the frames of one second, s."""

    second: int
    after_s: float
    """From the last measurement to the arrival."""
    long_s: float
    """From the latest end of exposure or scan to the arrival."""
    link_s: float
    """From the sending to the arrival; NaN where the publisher does not tell it."""


class EndWatch:
    """Compares the last measurements of one sensor's frames with their sending and arrival.

    Args:
        seconds: number of the last seconds with frames that are compared.
    """

    def __init__(self, seconds: int = _SECONDS) -> None:
        self._least: deque[_Least] = deque(maxlen=seconds)
        self._last = Last(0.0, "")
        self._stamps_ns: deque[int] = deque(maxlen=10)

    def add(self, last: Last, stamp_ns: int, *, sent_ns: int, arrival_ns: int) -> None:
        """Take a frame; ``sent_ns`` is 0 where its publisher does not state it."""
        self._last = last
        self._stamps_ns.append(stamp_ns)
        age_s = (arrival_ns - stamp_ns) / NANOSECONDS
        link_s = (arrival_ns - sent_ns) / NANOSECONDS if sent_ns else float("nan")
        least = _Least(
            arrival_ns // NANOSECONDS, age_s - last.after_s, age_s - last.ends_s(self._period_s), link_s
        )
        if self._least and self._least[-1].second == least.second:
            before = self._least.pop()
            least = _Least(least.second, *(min(pair) for pair in zip(least[1:], before[1:], strict=True)))
        self._least.append(least)

    @property
    def _period_s(self) -> float:
        """Least time between two of the last stamps, s; infinite where none rises."""
        steps_ns = [later - first for first, later in pairwise(self._stamps_ns) if later > first]
        return min(steps_ns) / NANOSECONDS if steps_ns else float("inf")

    @property
    def is_settled(self) -> bool:
        """Whether frames of enough seconds came."""
        return len(self._least) >= _LEAST_SECONDS

    @property
    def after_s(self) -> float:
        """Least time from the last measurement of a frame to its arrival, s; NaN before the first frame."""
        return min((each.after_s for each in self._least), default=float("nan"))

    @property
    def text(self) -> str:
        """When frames arrive, in words."""
        return f"{self.after_s:.3f} s after {self._last.what}{self._on_link(self.after_s)}"

    @property
    def _link_s(self) -> float:
        return min(each.link_s for each in self._least)

    def _on_link(self, of_s: float) -> str:
        return f", {self._link_s:.3f} s of it on the link" if self._link_s < of_s else ""

    def finding(self, *, clock_sigma_s: float, within_s: float) -> Finding | None:
        """Return what is wrong; None if nothing is, or if too few frames have come.

        Args:
            clock_sigma_s: standard deviation of the sensor's stamps, as it is declared.
            within_s: time within which frames arrive where nothing is wrong.
        """
        if not self.is_settled:
            return None
        if self._last.is_longer_than_a_scan(self._period_s):
            return Finding("point_time_unit", self._unit())
        if median(each.after_s for each in self._least) < -CLOCK_SIGMAS * clock_sigma_s:
            return Finding("clock_ahead", self._ahead(CLOCK_SIGMAS * clock_sigma_s))
        long_s = min(each.long_s for each in self._least)
        if long_s > within_s + CLOCK_SIGMAS * clock_sigma_s:
            return Finding("clock_behind", self._behind(long_s, within_s))
        return None

    def _unit(self) -> str:
        last = self._last
        spans_s = last.after_s - (last.begins_s or 0.0)
        stated = f", and the info states {last.lasts_s:.3f} s" if last.lasts_s else ""
        return (
            f"the times of a scan's points span {spans_s:.3g} s, scans come each {self._period_s:.3f} s"
            f"{stated}: they are in another unit, or the info is of another mode; let the driver send "
            "seconds from the stamp as float32 t, or nanoseconds as an integer"
        )

    def _ahead(self, allowed_s: float) -> str:
        text = (
            f"its stamps are at least {-self.after_s:.3f} s late: frames arrive before {self._last.what}, "
            f"{self._last.after_s:.3f} s after the stamp"
        )
        if self._link_s < -allowed_s:
            return (
                f"{text}, and {-self._link_s:.3f} s before they were sent; the clock of the driver's host is "
                "ahead of this one: synchronise both by PTP or chrony"
            )
        return (
            f"{text}; synchronise the sensor's clock, set source.clock_offset_s, or, if the driver stamps "
            "the end or the arrival, source.stamp to end with source.duration_s"
        )

    def _behind(self, long_s: float, within_s: float) -> str:
        timed = self._last.begins_s is not None
        start = "" if timed else "stamps of the start (set source.stamp and source.duration_s), "
        return (
            f"its stamps may be up to {long_s:.3f} s early: all frames arrive at least that long after the "
            f"end of exposure or scan{self._on_link(long_s)}, where {within_s:g} s is usual; causes: a clock "
            f"that is behind (synchronise it), {start}or a slow driver (set source.arrives_within_s); 'rpod "
            "calibrate clock' measures it from a log with truth"
        )
