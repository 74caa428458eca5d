"""Limits from the evidence of right poses: quantiles with a margin, and their intervals.

Frames of one satellite resemble each other, so the interval is that over random choices of the satellites
(the bootstrap by clusters, A. C. Davison, D. V. Hinkley, Bootstrap Methods and their Application, 1997).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, floor, log10

import numpy as np
import polars as pl

from rpod_campaign.limits.trial import START, UNAIDED
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.tuning import LimitField

RESAMPLES = 500
"""Number of random choices of the satellites."""
DIGITS = 2
"""Number of digits of a derived limit; it is rounded so that more poses pass."""


@dataclass(frozen=True)
class Derived:
    """A limit as derived, with what it does."""

    field: LimitField
    value: float
    """The derived limit, or today's if there is no evidence."""
    low: float
    """Lower end of its 95 % interval."""
    high: float
    """Upper end of this interval."""
    quantile: float
    """Share of right poses that meet it without the margin."""
    right: int
    """Number of right poses with this evidence."""
    bodies: int
    """Number of satellites with such poses."""


def derived(field: LimitField, by_body: Sequence[pl.DataFrame], *, quantile: float, margin: float) -> Derived:
    """Return a limit as derived from the rows of each satellite."""
    share = field.limit.usual or quantile
    widening = 0.0 if field.limit.usual else margin
    known = [values for values in (_right(rows, field.limit.evidence) for rows in by_body) if values.size]
    right = sum(values.size for values in known)
    if not right:
        return Derived(field, field.value, float("nan"), float("nan"), share, 0, 0)

    def limit(chosen: Sequence[FloatArray]) -> float:
        return _limit(np.concatenate(chosen), field, share, widening)

    generator = np.random.default_rng(0)
    drawn = [
        limit([known[index] for index in generator.integers(len(known), size=len(known))])
        for _ in range(RESAMPLES)
    ]
    low, high = np.quantile(drawn, (0.025, 0.975))
    return Derived(field, limit(known), float(low), float(high), share, right, len(known))


def refused(rows: pl.DataFrame, field: LimitField, value: float) -> pl.Series:
    """Return which poses a limit refuses."""
    evidence = rows[field.limit.evidence]
    return (evidence < value if field.limit.least else evidence > value).fill_null(value=False)


def _right(rows: pl.DataFrame, evidence: str) -> FloatArray:
    """Return the evidence of the right poses that the tracker reached without help, shape (N,)."""
    unaided = rows.filter("seen", "right", pl.col(START).is_in(UNAIDED))
    return unaided[evidence].drop_nulls().drop_nans().to_numpy().astype(np.float64)


def _limit(values: FloatArray, field: LimitField, share: float, margin: float) -> float:
    """Return the limit that a share of the values meets, widened by a margin, with few digits."""
    if field.limit.least:
        bare = float(np.quantile(values, 1.0 - share, method="lower"))
        return _rounded(bare - margin * abs(bare), floor, whole=field.is_whole)
    bare = float(np.quantile(values, share, method="higher"))
    return _rounded(bare + margin * abs(bare), ceil, whole=field.is_whole)


def _rounded(value: float, way: Callable[[float], int], *, whole: bool) -> float:
    """Return a value rounded up or down to ``DIGITS`` digits, or to a whole number."""
    if whole or value == 0.0:
        return way(value)
    digits = DIGITS - 1 - floor(log10(abs(value)))
    return round(way(round(value * 10.0**digits, 9)) / 10.0**digits, max(digits, 0))
