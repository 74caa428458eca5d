"""``integrity``: misleading frames, time to alert, false alerts, availability, and Stanford diagrams."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import polars as pl
from scipy.stats import beta, chi2

from rpod_campaign.engine.campaign import TRIAL, CellResult, described
from rpod_campaign.engine.report.charts import curve_figure, distinct
from rpod_campaign.engine.report.content import Section, Table
from rpod_campaign.engine.report.numbers import in_world, number, percent
from rpod_campaign.engine.report.statistics import consistency, quantile, root_mean_square
from rpod_campaign.integrity.cell import IntegrityCell
from rpod_campaign.integrity.faults import BY_NAME
from rpod_campaign.integrity.trial import FRAME

Results = Sequence[CellResult[IntegrityCell]]
_KEPT = 50
"""Largest number of misleading frames in the report's table; all are in the Parquet file."""
_POINTS = 3000
"""Largest number of frames of a fault in a Stanford diagram."""
_CONFIDENCE = 0.95
_LIMITS = {
    "level = error": ([1e-3, 1e2], [1e-3, 1e2]),
    "alert limits": ([1e-3, 1.0, 1.0], [1.0, 1.0, 1e-3]),
}
"""Lines of a Stanford diagram: frames below the first one are misleading, those in the box of the second one
are available with an error below the limit."""
_DIAGRAM = (
    "The diagrams show the frames in all states but alert. One below the line level = error is misleading, "
    "unless it is unavailable."
)
"""What a Stanford diagram shows."""


def summarise(cell: IntegrityCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return the summary of a cell.

    A sequence is alerted if there is a frame after which no estimate with an error above the alert limit has
    a usable state. The time to alert runs from the first error above the limit to this frame. An alert is
    false if it comes before the fault and before the first such error.
    """
    scored = rows.filter(pl.col("attitude_error_deg").is_not_null())
    available = (
        pl.col("attitude_level_deg").is_finite()  # NaN without a track, which polars takes as equal to NaN
        & (pl.col("attitude_level_deg") <= pl.col("attitude_limit_deg"))
        & (pl.col("position_level_m") <= pl.col("position_limit_m"))
    )
    delays_s = [_delay_s(each) for each in _sequences(rows)]
    harmed = [delay_s for delay_s in delays_s if delay_s is not None]
    told = [delay_s for delay_s in harmed if np.isfinite(delay_s)]
    hours = sum(_before(each).height for each in _sequences(rows)) / _rate_hz(cell) / 3600.0
    false_alerts = sum(_onsets(each) for each in _sequences(rows))
    return {
        **described(cell),
        "unit": BY_NAME[cell.fault].unit,
        "sequences": rows[TRIAL].n_unique(),
        "frames": rows.height,
        "misleading": int(rows["misleading"].sum()),
        "misleading_sequences": rows.filter(pl.col("misleading"))[TRIAL].n_unique(),
        "harmed_sequences": len(harmed),
        "alerted_share": len(told) / len(harmed) if harmed else None,
        "alert_sequences": rows.filter(pl.col("state") == "alert")[TRIAL].n_unique(),
        "time_to_alert_s": {
            name: float(np.quantile(told, share)) if told else None
            for name, share in (("p50", 0.5), ("p99", 0.99))
        },
        "false_alerts": false_alerts,
        "nominal_hours": hours,
        "false_alerts_per_hour": false_alerts / hours if hours else None,
        "availability": rows.select(available.fill_null(False).mean()).item(),
        **_sizes(scored),
        **consistency(scored),
    }


def _sizes(scored: pl.DataFrame) -> dict[str, float | None]:
    """Return RMS errors, median levels, and the ratios between them."""
    found: dict[str, float | None] = {}
    for name, unit in (("attitude", "deg"), ("position", "m")):
        error, level = scored[f"{name}_error_{unit}"], quantile(scored[f"{name}_level_{unit}"], 0.5)
        rms = root_mean_square(error.drop_nulls())
        found |= {f"{name}_rms_{unit}": rms, f"{name}_level_{unit}": level}
        found[f"{name}_level_over_rms"] = level / rms if level is not None and rms else None
    return found


def totals(results: Results) -> dict[str, Any]:
    """Return the totals of each sensor, with bounds of the misleading share by frame and by sequence."""
    found = {}
    for sensor in dict.fromkeys(result.cell.sensor for result in results):
        mine = [result for result in results if result.cell.sensor == sensor]
        for name, seen in (("seen", True), ("unseen_by_one", False)):
            part = [each for each in mine if BY_NAME[each.cell.fault].seen_by_one is seen]
            if part:
                found[f"{sensor}_{name}"] = _total(part)
    return found


def _total(results: Results) -> dict[str, Any]:
    def total(name: str) -> float:
        return float(sum(result.summary[name] for result in results))

    hours, alerts = total("nominal_hours"), int(total("false_alerts"))
    frames, sequences = int(total("frames")), int(total("sequences"))
    misleading, misled = int(total("misleading")), int(total("misleading_sequences"))
    low, high = poisson_interval(alerts)
    return {
        "frames": frames,
        "misleading": misleading,
        "misleading_share_below": share_bound(misleading, frames),
        "sequences": sequences,
        "misleading_sequences": misled,
        "misleading_sequence_share_below": share_bound(misled, sequences),
        "nominal_hours": hours,
        "false_alerts": alerts,
        "false_alerts_per_hour": alerts / hours if hours else None,
        "false_alerts_per_hour_interval": [low / hours, high / hours] if hours else None,
    }


def share_bound(count: int, of: int) -> float:
    """Return the upper 95 % bound of a share (C. J. Clopper and E. S. Pearson, Biometrika 26, 1934)."""
    return 1.0 if count >= of else float(beta.ppf(_CONFIDENCE, count + 1, of - count))


def poisson_interval(count: int) -> tuple[float, float]:
    """Return the 95 % interval of the mean of a Poisson count (F. Garwood, Biometrika 28, 1936)."""
    tail = 0.5 * (1.0 - _CONFIDENCE)
    low = 0.5 * float(chi2.ppf(tail, 2 * count)) if count else 0.0
    return low, 0.5 * float(chi2.isf(tail, 2 * count + 2))


def sections(results: Results) -> list[Section]:
    """Return the sections of the report."""
    seen = [result for result in results if BY_NAME[result.cell.fault].seen_by_one]
    unseen = [result for result in results if not BY_NAME[result.cell.fault].seen_by_one]
    parts = [
        Section(
            "Faults that one sensor can see",
            "Misleading: an error is above its protection level while the state is nominal or caution. "
            "Alerted: from a frame on, each error above the alert limit has the state alert or unavailable; "
            "the time runs to it from the first such error. Available: both levels are below the limits. "
            f"{_DIAGRAM}",
            (_table("Faults that one sensor can see", seen),),
            _stanford(seen),
        ),
        Section(
            "Faults that one sensor cannot see",
            "A wrong mount, an offset of the clock and a slow drift of the ranges are in no residual of the "
            "only sensor. The levels have a declared standard deviation of them: mount 0.02 deg and 1 mm, "
            "clock 2 ms, ranges 0.05 %. Larger ones are misleading unless a second sensor contradicts them. "
            f"{_DIAGRAM}",
            (_table("Faults that one sensor cannot see", unseen),),
            _stanford(unseen),
        ),
        Section(
            "Misleading frames",
            f"Cell, trial, frame and seed give each frame again; the first {_KEPT}.",
            (_replays(results),),
        ),
    ]
    return [part for part in parts if any(table.rows for table in part.tables)]


def _table(title: str, results: Results) -> Table:
    rows = []
    for result in results:
        cell, s = result.cell, result.summary
        rows.append(
            (
                in_world(cell.target, cell.world),
                cell.sensor,
                cell.fault,
                f"{cell.size:g} {s['unit']}".strip(),
                str(s["frames"]),
                f"{s['misleading']} in {s['misleading_sequences']} of {s['sequences']}",
                str(s["harmed_sequences"]),
                percent(s["alerted_share"]),
                str(s["alert_sequences"]),
                number(s["time_to_alert_s"]["p50"], ".2f"),
                number(s["time_to_alert_s"]["p99"], ".2f"),
                f"{s['false_alerts']} in {s['nominal_hours']:.2f} h",
                percent(s["availability"]),
                number(s["attitude_level_over_rms"], ".1f"),
                number(s["position_level_over_rms"], ".1f"),
                number(s["nees_mean"], ".1f"),
                percent(s["nees_share_in_95"]),
            )
        )
    columns = (
        *("target", "sensor", "fault", "size", "frames", "misleading, in sequences", "harmed", "alerted"),
        *("state alert", "p50, s", "p99, s", "false alerts", "available", "level/RMS attitude"),
        *("level/RMS position", "mean NEES", "inside 95 %"),
    )
    return Table(title, columns, tuple(rows)).condensed(2)


def _replays(results: Results) -> Table:
    rows = [
        (
            f"{result.cell.fault} {result.cell.size:g}",
            in_world(result.cell.target, result.cell.world),
            result.cell.sensor,
            *(str(row[name]) for name in ("seed", TRIAL, FRAME, "state")),
            f"{row['attitude_error_deg']:.2f} of {row['attitude_level_deg']:.2f}",
            f"{1e3 * row['position_error_m']:.0f} of {1e3 * row['position_level_m']:.0f}",
        )
        for result in results
        for row in result.rows.filter(pl.col("misleading")).iter_rows(named=True)
    ]
    columns = (
        *("fault", "target", "sensor", "seed", "trial", "frame", "state"),
        *("attitude, deg, of level", "position, mm, of level"),
    )
    return Table("Misleading frames", columns, tuple(rows[:_KEPT]))


def _stanford(results: Results) -> tuple[Any, ...]:
    """Return Stanford diagrams of attitude and position: error against level, over the alert limit both."""
    figures, lines = [], [_line(result.cell) for result in results]
    for name, unit in (("attitude", "deg"), ("position", "m")):
        limit, error, level = f"{name}_limit_{unit}", f"{name}_error_{unit}", f"{name}_level_{unit}"
        clouds = {}
        for result, line in zip(results, lines, strict=True):
            told = result.rows.filter(pl.col("usable") | (pl.col("state") == "unavailable"))
            known = told.filter(pl.col(error).is_not_null() & pl.col(level).is_finite())
            if known.height:
                shown = known.gather_every(max(1, known.height // _POINTS))
                clouds[distinct(line, lines) or line[-1]] = (
                    (shown[error] / shown[limit]).to_list(),
                    (shown[level] / shown[limit]).to_list(),
                )
        if clouds:
            figures.append(
                curve_figure(
                    clouds,
                    x_title=f"{name} error / alert limit",
                    y_title=f"{name} level / alert limit",
                    markers=True,
                    log_x=True,
                    log_y=True,
                    limits=_LIMITS,
                )
            )
    return tuple(figures)


def _line(cell: IntegrityCell) -> tuple[str, ...]:
    return in_world(cell.target, cell.world), cell.sensor, f"{cell.fault} {cell.size:g}"


def _sequences(rows: pl.DataFrame) -> list[pl.DataFrame]:
    return rows.sort(FRAME).partition_by(TRIAL)


def _delay_s(sequence: pl.DataFrame) -> float | None:
    """Return the time from the first error above the alert limit until no such frame is usable any more.

    None without such an error, infinite if the last such frame is usable.
    """
    harmful = sequence.filter(pl.col("harmful"))
    if not harmful.height:
        return None
    first_s, untold = float(harmful["time_s"][0]), harmful.filter(pl.col("usable"))
    if not untold.height:
        return 0.0
    after = harmful.filter(pl.col("time_s") > untold["time_s"].max())
    return float(after["time_s"][0]) - first_s if after.height else float("inf")


def _before(sequence: pl.DataFrame) -> pl.DataFrame:
    """Return the frames before any fault and any error above the alert limit."""
    return sequence.filter((pl.col("faulty") | pl.col("harmful")).cum_sum() == 0)


def _onsets(sequence: pl.DataFrame) -> int:
    """Return how often the state became alert before any fault and any error above the alert limit."""
    alert = (_before(sequence)["state"] == "alert").to_numpy()
    return int(alert[:1].sum() + (alert[1:] & ~alert[:-1]).sum())


def _rate_hz(cell: IntegrityCell) -> float:
    return {"lidar": 1.0, "pmd": cell.camera_hz, "both": cell.camera_hz + 1.0}[cell.sensor]
