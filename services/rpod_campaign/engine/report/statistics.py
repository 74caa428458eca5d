"""Statistics that every campaign uses."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl
from scipy.stats import binomtest

from rpod_analysis.scoring.score import NEES_95
from rpod_schemas.arrays import FloatArray


@dataclass(frozen=True)
class Rate:
    """A share of trials with its 95 % Wilson interval."""

    count: int
    of: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """Point estimate of the share; NaN for no trials."""
        return self.count / self.of if self.of else float("nan")

    @property
    def as_json(self) -> dict[str, Any]:
        """The share for JSON."""
        return {"count": self.count, "of": self.of, **self.named("rate")}

    def named(self, name: str) -> dict[str, float]:
        """Return the share under a name, with its interval."""
        return {name: self.value, "wilson_low": self.low, "wilson_high": self.high}

    def __str__(self) -> str:
        if not self.of:
            return "-"
        return f"{self.value:.3f} [{self.low:.3f}, {self.high:.3f}]"


def rate(count: int, of: int) -> Rate:
    """Return a share with its Wilson interval (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927)."""
    if not of:
        return Rate(0, 0, float("nan"), float("nan"))
    interval = binomtest(count, of).proportion_ci(confidence_level=0.95, method="wilson")
    return Rate(count, of, float(interval.low), float(interval.high))


def rate_of(rows: pl.DataFrame, condition: str | pl.Expr) -> Rate:
    """Return the share of the rows that meet a condition, or in which a column is true."""
    met = pl.col(condition) if isinstance(condition, str) else condition
    return rate(int(rows.select(met.fill_null(value=False).sum()).item()), rows.height)


def quantile(values: pl.Series, share: float) -> float | None:
    """Return a quantile of the finite values; None if there are none."""
    finite = _finite(values)
    return float(np.quantile(finite, share)) if finite.size else None


def mean(values: pl.Series) -> float | None:
    """Return the mean of the finite values; None if there are none."""
    finite = _finite(values)
    return float(finite.mean()) if finite.size else None


def root_mean_square(values: pl.Series) -> float | None:
    """Return the root of the mean square of all values; None if there are none."""
    return float(np.sqrt(np.mean(values.to_numpy() ** 2))) if values.len() else None


def _finite(values: pl.Series) -> FloatArray:
    numbers: FloatArray = values.drop_nulls().to_numpy().astype(np.float64)
    return numbers[np.isfinite(numbers)]


def consistency(rows: pl.DataFrame) -> dict[str, Any]:
    """Return the mean NEES, the mean of its degrees of freedom, and the share within the 95 % bound.

    Args:
        rows: rows with ``nees`` and ``nees_dof``; those whose NEES is not finite do not count.
    """
    known = rows.filter(pl.col("nees").is_finite())
    within = known["nees"] <= known["nees_dof"].replace_strict(NEES_95, return_dtype=pl.Float64)
    return {
        "nees_mean": mean(known["nees"]),
        "nees_dof": mean(known["nees_dof"]),
        "nees_share_in_95": mean(within.cast(pl.Float64)),
    }
