"""A sensor's stamps against their arrival: how old its frames are, and how its clock drifts.

The difference between arrival and stamp is the transport's delay plus the offset of the sensor's clock, which
one direction alone cannot separate. Delays only add, so that the least difference in each second follows the
clock.
"""

from collections import deque
from math import remainder

import numpy as np

from rpod_schemas.messages import NANOSECONDS

_SECONDS = 60
"""Number of seconds over which the drift is estimated."""
_LEAST_SECONDS = 10
TAI_S = 37.0
"""Time by which TAI is ahead of UTC since 2017."""
_UNITS = {"milliseconds": 1e-6, "microseconds": 1e-3, "seconds": 1e-9}
"""Units that a driver may count in place of nanoseconds, with the factor by which stamps are too small."""
_LATENCY_S = 1.0
_ZONE_S = 1800.0
"""Time zones differ by multiples of it."""
_DAY_S = 86_400.0
_SHARE = 1e-4
"""Share by which stamps in a wrong unit may differ from the time: two days in fifty years."""
_YEAR_NS = 365 * 86_400 * NANOSECONDS


class StampWatch:
    """Measures the stamps of one sensor."""

    def __init__(self) -> None:
        self._least_s: deque[tuple[int, float]] = deque(maxlen=_SECONDS)
        """Second of arrival, and least age on arrival in it, s."""

    def add(self, stamp_ns: int, arrival_ns: int) -> None:
        """Take the stamp of a frame, corrected by its source, and the time of its arrival."""
        second, age_s = arrival_ns // NANOSECONDS, (arrival_ns - stamp_ns) / NANOSECONDS
        if self._least_s and self._least_s[-1][0] == second:
            age_s = min(age_s, self._least_s.pop()[1])
        self._least_s.append((second, age_s))

    @property
    def age_s(self) -> float:
        """Least age on arrival in the last second with frames, s; negative if stamps are ahead."""
        return self._least_s[-1][1] if self._least_s else float("nan")

    @property
    def drift_ppm(self) -> float:
        """Rate of the sensor's clock over this machine's, less 1, in 1e-6; NaN in the first ten seconds."""
        if len(self._least_s) < _LEAST_SECONDS:
            return float("nan")
        second, age_s = np.array(self._least_s).T
        return float(-1e6 * np.polyfit(second - second[0], age_s, 1)[0])


def is_boot_time(ahead_s: float, stamp_ns: int) -> bool:
    """Return whether stamps that are ahead of the time by this much count from the start of a device."""
    return stamp_ns < _YEAR_NS < -ahead_s * NANOSECONDS


def is_local_time(ahead_s: float) -> bool:
    """Return whether stamps that are ahead of UTC by this much are probably local time."""
    return 0.5 * _ZONE_S < abs(ahead_s) < _DAY_S and abs(remainder(ahead_s, _ZONE_S)) < _LATENCY_S


def clock_hint(ahead_s: float, stamp_ns: int) -> str:
    """Return what probably is wrong with a clock whose stamps are ahead of the time, and what to do."""
    if stamp_ns == 0:
        return "there is no stamp: let the driver set header.stamp"
    for unit, factor in _UNITS.items():
        due_ns = factor * (stamp_ns - ahead_s * NANOSECONDS)
        if abs(stamp_ns - due_ns) < _SHARE * due_ns:
            return f"are they {unit} in place of nanoseconds? Let the driver stamp in seconds and nanoseconds"
    if is_boot_time(ahead_s, stamp_ns):
        return "the stamps count from the start of the device; let its driver stamp in UTC"
    if abs(ahead_s - TAI_S) < _LATENCY_S:
        return "is it TAI? Synchronise the sensor to UTC, or set source.clock_offset_s of the sensor to 37"
    if is_local_time(ahead_s):
        return "is it local time? Let the driver stamp in UTC"
    clock = "check the sensor's clock, or set source.clock_offset_s of the sensor"
    return (
        clock if ahead_s > 0.0 else f"{clock}; if that is right, look at its driver and its link for a delay"
    )
