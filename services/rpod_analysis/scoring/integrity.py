"""Integrity of a run: misleading estimates, alerts, and the share of estimates with levels below the limits.

Misleading: an error is above its protection level while the state is nominal or caution (RTCA DO-229 calls it
misleading information).
"""

from dataclasses import dataclass, replace

import numpy as np

from rpod_analysis.scoring.row_store import Row
from rpod_analysis.scoring.score import BoolArray, Errors, IntArray
from rpod_schemas.arrays import FloatArray
from rpod_schemas.summary import IntegrityCount
from rpod_schemas.types import IntegrityState

_USABLE = [state.value for state in IntegrityState if state.is_usable]
_MOST_ALERTS = 100
"""Largest number of alerts that are kept with their times and reasons."""


@dataclass(frozen=True, eq=False)
class Integrities:
    """Integrity of N results as the estimator stated it, in the order of their stamps, shape (N,)."""

    stamp_ns: IntArray
    """Stamps, ns of UTC."""
    time_s: FloatArray
    """Stamps as seconds from the start of the run."""
    state: IntArray
    """Values of ``IntegrityState``."""
    levels: FloatArray
    """Protection levels of attitude, deg, and position, m, shape (N, 2); NaN without an estimate."""
    limits: FloatArray
    """Alert limits of the same, shape (N, 2)."""
    reasons: tuple[str, ...]
    """Reason of each state; empty for nominal."""

    @classmethod
    def of(cls, rows: list[Row], start_ns: int) -> "Integrities":
        """Return rows of stamp, state, levels, limits and reason, in a run that starts at ``start_ns``."""
        numbers = np.array([row[2:6] for row in rows], np.float64).reshape(-1, 4)
        stamp_ns = np.array([row[0] for row in rows], np.int64)
        return cls(
            stamp_ns,
            (stamp_ns - start_ns) * np.float64(1e-9),
            np.array([row[1] for row in rows], np.int64),
            numbers[:, :2],
            numbers[:, 2:],
            tuple(row[6] for row in rows),
        )


@dataclass(frozen=True)
class Alert:
    """A time in which each result had the state alert."""

    begin_s: float
    """Time of its first result from the start of the run."""
    end_s: float | None
    """Time of the first result after it; None if the alert lasted to the end of the log."""
    reason: str
    """Reason of its first result."""


class IntegrityTotals:
    """Counts of a run, added up minute by minute."""

    def __init__(self) -> None:
        self.alerts: list[Alert] = []
        """Alerts in their order; the first ones only."""
        self._misleading = self._scored = self._alerts = self._available = self._count = 0
        self._last = -1

    def take(self, told: Integrities, estimate_ns: IntArray, errors: Errors) -> None:
        """Add a minute: its states and levels, and the stamps and errors of its estimates."""
        if not told.stamp_ns.size:
            return
        states = np.concatenate(([self._last], told.state))
        self._take_alerts(told, states == IntegrityState.ALERT)
        self._last = int(states[-1])
        started = self._count > 0 or np.isfinite(told.levels).all(axis=1).cumsum() > 0
        self._count += int(np.broadcast_to(started, told.state.shape).sum())
        self._available += int((told.levels <= told.limits).all(axis=1).sum())
        misleading, scored = _misleading(told, estimate_ns, errors)
        self._misleading += misleading
        self._scored += scored

    def _take_alerts(self, told: Integrities, alert: BoolArray) -> None:
        """Add the alerts that begin or end in a minute; ``alert`` has its results and the one before."""
        for index in np.flatnonzero(alert[1:] != alert[:-1]):
            time_s = float(told.time_s[index])
            if alert[index + 1]:
                self._alerts += 1
                if len(self.alerts) < _MOST_ALERTS:
                    self.alerts.append(Alert(time_s, None, told.reasons[index]))
            elif self._alerts == len(self.alerts):
                self.alerts[-1] = replace(self.alerts[-1], end_s=time_s)

    def summary(self) -> IntegrityCount | None:
        """Return the counts; None for a log without integrity."""
        if self._last < 0:
            return None
        return IntegrityCount(
            misleading=self._misleading if self._scored else None,
            alerts=self._alerts,
            availability=self._available / self._count if self._count else None,
        )


def _misleading(told: Integrities, estimate_ns: IntArray, errors: Errors) -> tuple[int, int]:
    """Return how many estimates are misleading, and how many have both truth and integrity."""
    known_ns, known = estimate_ns[errors.scored], np.flatnonzero(errors.scored)
    if not known_ns.size:
        return 0, 0
    place = np.searchsorted(known_ns, told.stamp_ns).clip(0, known_ns.size - 1)
    matched = known_ns[place] == told.stamp_ns
    index = known[place[matched]]
    sizes = np.column_stack([np.rad2deg(errors.angle_rad[index]), errors.distance_m[index]])
    above = np.any(sizes > told.levels[matched], axis=1)
    usable = np.isin(told.state[matched], _USABLE)
    return int((above & usable).sum()), int(matched.sum())
