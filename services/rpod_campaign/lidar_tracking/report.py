"""``lidar-tracking``: single scans with a start error of 5 deg and 0.3 m, and tumbling targets at 1 Hz."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import polars as pl

from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.report.charts import distribution_figure
from rpod_campaign.engine.report.content import Section, Table
from rpod_campaign.engine.report.numbers import in_world, millimetres, milliseconds, number, percent, word
from rpod_campaign.engine.report.statistics import consistency, quantile, rate, rate_of
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.returns import ELLIPSE_RETURNS
from rpod_campaign.lidar.scores import wrong
from rpod_campaign.lidar_tracking.trial import (
    FRAMES,
    OFF_DEG,
    OFF_M,
    OFF_SHARE,
    TrackingCell,
)

Results = Sequence[CellResult[TrackingCell]]


def summarise(cell: TrackingCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return the summary of a cell; single scans have no frames, sequences no NEES.

    ``success_rate`` and ``wrong_accepted`` of sequences are over frames: not lost, and accepted with an error
    of 3 deg or more. A sequence has one track, so that none of its frames is ambiguous.
    """
    if cell.range_m is None:
        frames = int(rows["frames"].sum())
        return {
            **asdict(cell),
            "trials": rows.height,
            "frames": frames,
            "lost_frames": int(rows["lost_frames"].sum()),
            "rejected_frames": int(rows["rejected_frames"].sum()),
            "worst_deg": quantile(rows["worst_deg"], 1.0),
            "median_deg": quantile(rows["attitude_error_deg"], 0.5),
            "success_rate": rate(frames - int(rows["lost_frames"].sum()), frames).value,
            "wrong_accepted": int(rows["wrong_frames"].sum()),
            "ambiguous": 0,
        }
    off = wrong(rows, cached_target(cell.target))
    return {
        **asdict(cell),
        "trials": rows.height,
        "success_rate": rate_of(rows, "success").value,
        "wrong_accepted": int((off & rows["accepted"]).sum()),
        "right_rejected": int((~off & ~rows["accepted"]).sum()),
        "ambiguous": int(rows["ambiguous"].sum()),
        "median_deg": quantile(rows["attitude_error_deg"], 0.5),
        "p95_deg": quantile(rows["attitude_error_deg"], 0.95),
        "median_m": quantile(rows["position_error_m"], 0.5),
        "p95_m": quantile(rows["position_error_m"], 0.95),
        "median_s": quantile(rows["track_s"], 0.5),
        "p95_s": quantile(rows["track_s"], 0.95),
        **consistency(rows.filter(pl.col("reason") == "")),
    }


def sections(results: Results) -> list[Section]:
    """Return the sections of the report."""
    single = [result for result in results if result.cell.range_m is not None]
    sequences = [result for result in results if result.cell.range_m is None]
    return [
        Section(
            "Single scans",
            f"Each scan is tracked from a pose with an error of {OFF_DEG:g} deg and {OFF_M:g} m "
            f"({100.0 * OFF_SHARE:g} % of the longest side for a target that is no shipped one); attitudes "
            "have uniform Euler angles. NEES of the independent trials that the self-check accepts: the "
            "expected mean is its degrees of freedom (the next column: 6, or 5 with a free axis), and the "
            "expected share inside the bound is 95 %.",
            (_single_table(single),),
            _figures(single),
        ),
        Section(
            "Tumbling, once a second",
            f"Sequences of {FRAMES} s on the safety ellipse of 25 to 53 m (for a target that is no shipped "
            f"one, from where {ELLIPSE_RETURNS:g} returns come on), through the navigator and its "
            "filter, which start at the true pose without a twist. Lost: not tracking, or an attitude error "
            "of 3 deg or more.",
            (_sequence_table(sequences),),
        ),
    ]


def _single_table(results: Results) -> Table:
    rows = []
    for result in results:
        cell, s = result.cell, result.summary
        rows.append(
            (
                in_world(cell.target, cell.world, cell.surroundings),
                cell.tracker,
                word(cell.range_m),
                str(result.rows.height),
                str(rate_of(result.rows, "success")),
                number(s["median_deg"], ".3f"),
                number(s["p95_deg"], ".3f"),
                millimetres(s["median_m"]),
                millimetres(s["p95_m"]),
                milliseconds(s["median_s"]),
                milliseconds(s["p95_s"]),
                number(s["nees_mean"], ".2f"),
                number(s["nees_dof"], "g"),
                percent(s["nees_share_in_95"]),
            )
        )
    columns = (
        *("target", "tracker", "range, m", "trials", "within 3 deg", "median, deg", "p95, deg"),
        *("median, mm", "p95, mm", "median, ms", "p95, ms", "mean NEES", "of", "inside 95 %"),
    )
    return Table("Tracking single scans", columns, tuple(rows)).condensed(2)


def _sequence_table(results: Results) -> Table:
    rows = [
        (
            in_world(result.cell.target, result.cell.world, result.cell.surroundings),
            result.cell.tracker,
            word(result.cell.rate_deg_s),
            str(result.rows.height),
            f"{result.summary['lost_frames']} of {result.summary['frames']}",
            word(result.summary["rejected_frames"]),
            number(result.summary["median_deg"], ".3f"),
            number(result.summary["worst_deg"], ".2f"),
        )
        for result in results
    ]
    columns = ("target", "tracker", "rate, deg/s", "sequences", "lost frames", "rejected", "median, deg")
    return Table("Tracking a tumble", (*columns, "worst, deg"), tuple(rows)).condensed(2)


def _figures(results: Results) -> tuple[Any, ...]:
    """Return the distribution of the attitude error of each tracker and range."""
    errors_deg = {}
    for result in results:
        target = in_world(result.cell.target, result.cell.world, result.cell.surroundings)
        name = f"{target}, {result.cell.tracker}, {result.cell.range_m:g} m"
        errors_deg[name] = result.rows["attitude_error_deg"]
    return (distribution_figure(errors_deg),)
