"""``lidar-range``: success of acquisition over range and scan step, beside OBB-TM's published figures."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import polars as pl

from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.report.charts import distinct, rate_figure
from rpod_campaign.engine.report.content import Section, Table
from rpod_campaign.engine.report.numbers import NONE, in_world, milliseconds, number, printed, word
from rpod_campaign.engine.report.statistics import Rate, mean, quantile, rate_of
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.scores import ambiguous, wrong
from rpod_campaign.lidar_range.trial import RangeCell, lidar_of
from rpod_target import Target, is_shipped

Results = Sequence[CellResult[RangeCell]]
OBB_TM_1_DEG = {
    20.0: "about 0.69",
    30.0: "0.96",
    40.0: "0.975",
    50.0: "0.95",
    60.0: "0.95",
    80.0: "0.72",
    120.0: "0.43",
}
"""Success of OBB-TM at a scan step of 1 deg, by range in m, with a detailed CAD model and no detection model.
The values are from a report on it, not from the publication itself."""


CRITERION_DEG, CRITERION_M = 5.0, 0.2
"""OBB-TM's criterion of success: attitude error, deg, and position error, m."""


def close(rows: pl.DataFrame, target: Target) -> Rate:
    """Return the share within 5 deg and 0.2 m; for a target that is not shipped, that of successes."""
    if not is_shipped(target):
        return rate_of(rows, "success")
    near = (pl.col("attitude_error_deg") < CRITERION_DEG) & (pl.col("position_error_m") < CRITERION_M)
    return rate_of(rows, near)


def summarise(cell: RangeCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return the summary of a cell."""
    lidar = lidar_of(cell)
    return {
        **asdict(cell),
        "window_deg": lidar.pattern.azimuth_span_deg,
        "scan_time_s": lidar.scan_time_s,
        "trials": rows.height,
        "mean_returns": mean(rows["returns"]),
        **close(rows, cached_target(cell.target)).named("success_rate"),
        "accepted": int(rows["accepted"].sum()),
        "wrong_accepted": int((wrong(rows, cached_target(cell.target)) & rows["accepted"]).sum()),
        **ambiguous(rows),
        "median_s": quantile(rows["acquire_s"], 0.5),
        "p95_s": quantile(rows["acquire_s"], 0.95),
    }


def sections(results: Results) -> list[Section]:
    """Return the sections of the report."""
    lines: dict[str, dict[float, Rate]] = {}
    names = [_line(result.cell) for result in results]
    for result, line in zip(results, names, strict=True):
        cell = result.cell
        points = lines.setdefault(distinct(line, names) or cell.method, {})
        points[cell.range_m] = close(result.rows, cached_target(cell.target))
    note = (
        f"Success: within {CRITERION_DEG:g} deg and {CRITERION_M:g} m, OBB-TM's criterion, with 95 % Wilson "
        "intervals. Detection off: every ray that meets the target returns, as for OBB-TM. The window has "
        "the target's bounding sphere, 40 deg at most; the scan time is that of the window at 10 kHz."
    )
    figure = rate_figure(lines, x_title="range [m]")
    return [Section("Range and scan step", note, (_table(results),), (figure,))]


def _line(cell: RangeCell) -> tuple[str, ...]:
    return (
        in_world(cell.target, cell.world),
        cell.method,
        NONE if cell.step_deg is None else f"templates {cell.step_deg:g} deg",
        f"scan {cell.scan_step_deg:g} deg",
        f"detection {cell.detection}",
    )


def _table(results: Results) -> Table:
    rows = []
    for result in results:
        cell, s = result.cell, result.summary
        published = OBB_TM_1_DEG if cell.scan_step_deg == 1.0 else {}
        rows.append(
            (
                in_world(cell.target, cell.world),
                cell.method,
                word(cell.step_deg),
                cell.detection,
                word(cell.scan_step_deg),
                word(cell.range_m),
                word(s["window_deg"]),
                number(s["scan_time_s"], ".2f"),
                word(s["trials"]),
                number(s["mean_returns"], ".0f"),
                str(close(result.rows, cached_target(result.cell.target))),
                printed(published, cell.range_m),
                milliseconds(s["median_s"]),
                milliseconds(s["p95_s"]),
            )
        )
    columns = (
        *("target", "method", "step, deg", "detection", "scan step, deg", "range, m", "window, deg"),
        *("scan time, s", "trials", "mean returns", "success", "OBB-TM", "median, ms", "p95, ms"),
    )
    return Table("Success", columns, tuple(rows)).condensed(4)
