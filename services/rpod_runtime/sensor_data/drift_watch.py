"""Whether a sensor's clock drifts so far that its stamps are no longer as exact as they are declared.

The error of a synchronised clock stays within its declared tolerance (``integrity.clock_sigma_s``). Any other
clock was right at best when it was last synchronised, which was before the watch began. So the drift is too
large once it has moved the stamps by more than the declared tolerance since the watch began.

Delays only add, so the least age on arrival in each stretch of time follows the clock. A load that begins and
stays moves the ages in one step, but a drift moves them steadily. So both halves of the time must show it.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

from rpod_schemas.arrays import FloatArray
from rpod_schemas.messages import NANOSECONDS

_STRETCH_NS = 5 * NANOSECONDS
"""Stretch of time of which the least age is kept. Chosen by hand: some frames of a sensor at 1 Hz."""
_LEAST, _MOST = 12, 720
"""Number of stretches from which on a drift is reported (a minute), and number that is kept (an hour)."""
CLOCK_SIGMAS = 4.0
"""Error of a clock, in the standard deviations that are declared for it, beyond which it is not synchronised
as declared."""
_NOISE_SIGMAS = 5.0
"""Least ratio of a drift to its standard deviation, by the scatter of the ages."""
_EVEN = 0.5
"""Least ratio of the movements in the two halves, the smaller over the larger, for them to be one drift."""


class Drift(NamedTuple):
    """A drift of a sensor's clock that is certain."""

    ppm: float
    """Rate of the sensor's clock over this machine's, less 1, in 1e-6."""
    moved_s: float
    """Change of the stamps against this machine's clock over the time, s."""
    time_s: float

    def describe(self, clock_sigma_s: float) -> str:
        """Return the text for the operator, with figures and remedies."""
        fast = self.ppm > 0.0
        queue = "" if fast else "; or its frames take longer and longer: look at the driver's queue"
        return (
            f"its clock runs {abs(self.ppm):.0f} ppm too {'fast' if fast else 'slow'}: its stamps have moved "
            f"by {1e3 * self.moved_s:.1f} ms in {self.time_s:.0f} s, and integrity.clock_sigma_s declares "
            f"{1e3 * clock_sigma_s:g} ms; synchronise the sensor by PTP or chrony, or let its driver map its "
            f"clock to UTC continuously{queue}"
        )


class Trend(NamedTuple):
    """Change of the ages of frames on arrival over time: a straight line through them."""

    slope: float
    """Change of the age, s/s: positive for a clock that runs too slow."""
    sigma: float
    """Standard deviation of the slope, by the scatter of the ages."""
    is_even: bool
    """Whether both halves of the time show it alike, as they do for a drift, and not for a load."""


def trend(time_s: FloatArray, age_s: FloatArray) -> Trend:
    """Return the change of ages, shape (N,), at times in order, shape (N,); N is 4 or more."""
    (slope, _), covariance = np.polyfit(time_s, age_s, 1, cov=True)
    steps_s = np.sign(slope) * np.diff([part.min() for part in np.array_split(age_s, 3)])
    is_even = bool(steps_s.min() >= _EVEN * steps_s.max())
    return Trend(float(slope), float(np.sqrt(covariance[0, 0])), is_even)


class DriftWatch:
    """Follows the stamps of one sensor against this machine's clock."""

    def __init__(self) -> None:
        self._least_s: deque[tuple[int, float]] = deque(maxlen=_MOST)
        """Number of the stretch, and least age on arrival in it, s."""

    def add(self, stamp_ns: int, arrival_ns: int) -> bool:
        """Take a frame's stamp, corrected by its source, and its arrival; return whether a stretch begins."""
        stretch, age_s = arrival_ns // _STRETCH_NS, (arrival_ns - stamp_ns) / NANOSECONDS
        if self._least_s and self._least_s[-1][0] == stretch:
            self._least_s[-1] = stretch, min(age_s, self._least_s[-1][1])
            return False
        self._least_s.append((stretch, age_s))
        return True

    def drift(self, clock_sigma_s: float) -> Drift | None:
        """Return a drift beyond what is declared; None if there is none, or not certainly.

        Args:
            clock_sigma_s: standard deviation of the sensor's stamps, as it is declared.
        """
        if len(self._least_s) <= _LEAST:
            return None
        whole = np.array(self._least_s)[:-1]  # the last stretch has just begun
        time_s, age_s = (whole[:, 0] - whole[0, 0]) * (_STRETCH_NS / NANOSECONDS), whole[:, 1]
        found = trend(time_s, age_s)
        moved_s = abs(found.slope) * float(time_s[-1])
        if moved_s <= CLOCK_SIGMAS * clock_sigma_s or abs(found.slope) <= _NOISE_SIGMAS * found.sigma:
            return None
        return Drift(-1e6 * found.slope, moved_s, float(time_s[-1])) if found.is_even else None
