"""``navigation``: NEES and NIS with their intervals over trials, availability, and handovers."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import polars as pl
from scipy.stats import bootstrap

from rpod_analysis.scoring.handover import AcceptedFrames
from rpod_analysis.scoring.score import NEES_95
from rpod_campaign.engine.campaign import TRIAL, CellResult, described
from rpod_campaign.engine.report.charts import curve_figure, distinct
from rpod_campaign.engine.report.content import Section, Table
from rpod_campaign.engine.report.numbers import in_world, millimetres, number, percent
from rpod_campaign.engine.report.statistics import root_mean_square
from rpod_campaign.navigation.trial import FRAME, NavigationCell
from rpod_schemas.arrays import FloatArray
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.types import Mode

Results = Sequence[CellResult[NavigationCell]]
SETTLED_SHARE = 0.25
"""Share of a trial that is not scored: the filter begins at the true pose, without an error."""
_TRACKED = [mode.name for mode in Mode if mode.has_track]
_CHANGES = ("change_deg", "change_m", "jump_deg", "jump_m")


class Mean(NamedTuple):
    """A mean over trials with its 95 % interval."""

    value: float
    low: float
    high: float


def over_trials(rows: pl.DataFrame, column: str) -> Mean | None:
    """Return the mean of a column's means over trials with its bootstrap interval; None without a value.

    Errors of a trial's frames are not independent, therefore trials are drawn, not frames (B. Efron, Annals
    of Statistics 7, 1979; the percentile method).
    """
    means = means_of_trials(rows, column)
    if not means.size:
        return None
    value = float(means.mean())
    if means.size == 1:
        return Mean(value, float("nan"), float("nan"))
    drawn = bootstrap((means,), np.mean, method="percentile", rng=np.random.default_rng(0))
    return Mean(value, float(drawn.confidence_interval.low), float(drawn.confidence_interval.high))


def means_of_trials(rows: pl.DataFrame, column: str) -> FloatArray:
    """Return the mean of a column's finite values in each trial that has some, shape (N,)."""
    known = rows.filter(pl.col(column).is_finite())
    means: FloatArray = (
        known.group_by(TRIAL, maintain_order=True).agg(pl.col(column).mean())[column].to_numpy()
    )
    return means


def settled(cell: NavigationCell, rows: pl.DataFrame) -> pl.DataFrame:
    """Return the rows that are scored."""
    return rows.filter(pl.col("since_s") >= SETTLED_SHARE * cell.seconds)


def summarise(cell: NavigationCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return the summary of a cell."""
    bound = pl.col("nees_dof").replace_strict(NEES_95, return_dtype=pl.Float64)
    scored = settled(cell, rows).with_columns(
        **{
            f"{name}_inside": pl.when(pl.col(name).is_finite()).then((pl.col(name) <= bound).cast(pl.Float64))
            for name in ("nees", "nis")
        }
    )
    handovers = [found for each in rows.sort(FRAME).partition_by(TRIAL) for found in _handovers(each)]
    ends = rows.sort(FRAME).group_by(TRIAL).agg(pl.col("mode").last())
    return {
        **described(cell),
        "trials": rows[TRIAL].n_unique(),
        "frames": scored.height,
        "accepted_share": scored["accepted"].mean(),
        "ends_without_track": ends.filter(~pl.col("mode").is_in(_TRACKED)).height,
        "availability": scored["available"].mean(),
        "attitude_rms_deg": root_mean_square(scored["attitude_error_deg"].drop_nulls()),
        "position_rms_m": root_mean_square(scored["position_error_m"].drop_nulls()),
        **{
            name: _as_json(over_trials(scored, name)) for name in ("nees", "nees_inside", "nis", "nis_inside")
        },
        "handovers": {"count": len(handovers), **_largest(handovers)},
    }


def _largest(handovers: Sequence[Mapping[str, float | None]]) -> dict[str, float | None]:
    """Return the largest of each number of the handovers; None where no handover has it."""
    found: dict[str, float | None] = {}
    for name in ("gap_s", *_CHANGES):
        values = [value for each in handovers if (value := each[name]) is not None]
        found[name] = max(values, default=None)
    return found


def _as_json(mean: Mean | None) -> dict[str, float] | None:
    return None if mean is None else {"mean": mean.value, "low": mean.low, "high": mean.high}


def _handovers(trial: pl.DataFrame) -> Iterator[dict[str, float | None]]:
    """Yield gap, s, largest changes and jumps of the handovers of a trial, as the report of a log does.

    Changes and jumps are None without an estimate before the handover.
    """
    accepted = AcceptedFrames()
    stamped = trial.with_columns(stamp_ns=(pl.col("time_s") * NANOSECONDS).round().cast(pl.Int64))
    for sensor, stamp_ns in stamped.filter("accepted").select("sensor", "stamp_ns").rows():
        others_ns = accepted.take(sensor, stamp_ns)
        if others_ns is not None:
            around = stamped.filter(pl.col("stamp_ns").is_between(others_ns, stamp_ns))
            (largest,) = around.select(pl.col(_CHANGES).fill_nan(None).max()).to_dicts()
            yield {"gap_s": (stamp_ns - others_ns) / NANOSECONDS, **largest}


def sections(results: Results) -> list[Section]:
    """Return the sections of the report."""
    note = (
        "NEES: squared error by its covariance, six degrees of freedom. NIS: the same of a measurement "
        "against its prediction. Brackets are 95 % bootstrap intervals over trials. The covariance is true "
        "where the mean is 6 and 95 % are inside. Available: both protection levels are below their alert "
        f"limits. The first {100.0 * SETTLED_SHARE:g} % of each trial are not scored."
    )
    tables = [_table(results)]
    if any(result.summary["handovers"]["count"] for result in results):
        tables.append(_handover_table(results))
    return [Section("Scenarios", note, tuple(tables), (_figure(results),))]


def _figure(results: Results) -> Any:
    """Return the share of the trials whose mean NEES is below a value."""
    names = [_name(result.cell) for result in results]
    curves = {}
    for result, name in zip(results, names, strict=True):
        means = np.sort(means_of_trials(settled(result.cell, result.rows), "nees"))
        share = np.arange(1, means.size + 1) / max(means.size, 1)
        curves[distinct(name, names) or name[0]] = (means.tolist(), share.tolist())
    below = "share of the trials below it"
    return curve_figure(curves, x_title="mean NEES of a trial", y_title=below, log_x=True)


def _name(cell: NavigationCell) -> tuple[str, ...]:
    declared = number(cell.declared if cell.off_mm else None)
    what = cell.misbuilt if cell.off_mm else number(None)
    scenario = in_world(cell.scenario, cell.world)
    if cell.case != "scenario":
        scenario = f"{scenario}, {cell.case}"
    off = (f"{cell.off_mm:g}", what, declared)
    return scenario, cell.target, number(cell.rate_hz), cell.motion, cell.mounts, *off


_NAMES = (
    *("scenario", "target", "camera, Hz", "motion", "mounts"),
    *("off, mm", "what is off", "declared over true"),
)


def _table(results: Results) -> Table:
    rows = [
        (
            *_name(result.cell),
            str(s["trials"]),
            percent(s["accepted_share"]),
            str(s["ends_without_track"]),
            percent(s["availability"]),
            number(s["attitude_rms_deg"], ".3f"),
            millimetres(s["position_rms_m"]),
            _interval(s["nees"], ".1f"),
            _interval(s["nees_inside"], ".3f"),
            _interval(s["nis"], ".1f"),
            _interval(s["nis_inside"], ".3f"),
        )
        for result in results
        for s in (result.summary,)
    ]
    columns = (
        *(*_NAMES, "trials", "accepted", "end without track", "available", "attitude, deg RMS"),
        *("position, mm RMS", "mean NEES", "inside 95 %", "mean NIS", "NIS inside 95 %"),
    )
    return Table("Estimates", columns, tuple(rows)).condensed(len(_NAMES))


def _handover_table(results: Results) -> Table:
    rows = [
        (
            *_name(result.cell),
            str(found["count"]),
            number(found["gap_s"], ".2f"),
            number(found["change_deg"], ".2f"),
            millimetres(found["change_m"]),
            number(found["jump_deg"], ".2f"),
            millimetres(found["jump_m"]),
        )
        for result in results
        for found in (result.summary["handovers"],)
        if found["count"]
    ]
    columns = (
        *(*_NAMES, "handovers", "longest gap, s", "largest change, deg", "largest change, mm"),
        *("beyond the covariance, deg", "beyond the covariance, mm"),
    )
    return Table("Handovers", columns, tuple(rows)).condensed(len(_NAMES))


def _interval(mean: dict[str, float] | None, form: str) -> str:
    if mean is None:
        return number(None)
    shown = number(mean["mean"], form)
    return shown if np.isnan(mean["low"]) else f"{shown} [{mean['low']:{form}}, {mean['high']:{form}}]"
