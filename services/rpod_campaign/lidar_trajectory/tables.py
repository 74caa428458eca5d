"""The 2015 paper's tables over the trajectory, with results of this project beside the printed values."""

from collections.abc import Iterator, Sequence

import numpy as np
import polars as pl

from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.report.content import Table
from rpod_campaign.engine.report.numbers import in_world, milliseconds, number, printed, word
from rpod_campaign.engine.report.statistics import Rate, mean, quantile, rate_of
from rpod_campaign.lidar_trajectory.trial import TrajectoryCell
from rpod_campaign.papers import paper_2015 as paper

Result = CellResult[TrajectoryCell]
Results = Sequence[Result]

_NAMES = ("target", "Eq. 4", "centroid", "method", "step, deg")


def success(result: Result, icp: str = "nn") -> Rate:
    """Return the success rate with one of the ICPs."""
    return rate_of(result.rows, f"{icp}_success")


def success_table(results: Results) -> Table:
    """Return success, templates and time over the step (Fig. 6)."""
    rows = []
    for result in results:
        cell, step_deg = result.cell, result.cell.step_deg
        basic = cell.method == paper.TM
        rows.append(
            (
                *_name(cell),
                str(result.rows.height),
                str(success(result)),
                printed(paper.TRAJECTORY_SUCCESS, step_deg) if basic else "",
                str(success(result, "ns")),
                word(result.summary["templates"]),
                printed(paper.TEMPLATES, step_deg),
                milliseconds(mean(result.rows["search_s"])),
                printed(paper.TIME_S, step_deg) if basic else "",
            )
        )
    columns = ("positions", "success, NN", "paper, NN", "success, NS", "templates", "paper, templates")
    return Table(
        "Success, templates and time", (*_NAMES, *columns, "mean, ms", "paper, s (MATLAB)"), tuple(rows)
    ).condensed(len(_NAMES))


def fast_table(results: Results) -> Table:
    """Return success lost and time saved by the fast variant (Fig. 7)."""
    rows = []
    for basic, fast in _pairs(results):
        step_deg = basic.cell.step_deg
        saved = 1.0 - _ratio(mean(fast.rows["search_s"]), mean(basic.rows["search_s"]))
        rows.append(
            (
                *_name(fast.cell),
                number(success(basic).value - success(fast).value, "+.3f"),
                printed(paper.TRAJECTORY_LOSS, step_deg),
                number(mean(fast.rows["excluded_share"]), ".3f"),
                str(paper.EXCLUDED),
                number(saved, "+.3f"),
                str(paper.TIME_SAVED),
            )
        )
    columns = ("success lost", "paper", "excluded", "paper, excluded", "time saved", "paper, time saved")
    return Table(
        "Fast template matching against template matching", (*_NAMES, *columns), tuple(rows)
    ).condensed(len(_NAMES))


def attitude_table(results: Results) -> Table:
    """Return the errors of the template's Euler angles over the successes (Table 2)."""
    rows = []
    for result in results:
        good = result.rows.filter(pl.col("nn_success"))
        raw, wrapped = _columns(good, "euler_raw_deg"), _columns(good, "euler_wrapped_deg")
        prints = paper.EULER_ERRORS if result.cell.method == paper.TM else {}
        counts = paper.TRAJECTORY_SUCCESSES if result.cell.method == paper.TM else {}
        rows.append(
            (
                *_name(result.cell),
                str(good.height),
                printed(counts, result.cell.step_deg),
                *(number(value, ".2f") for value in raw),
                *(number(value, ".2f") for value in wrapped),
                number(mean(good["template_attitude_error_deg"]), ".2f"),
                _joined(prints.get(result.cell.step_deg), ".2f"),
            )
        )
    angles = ("roll", "pitch", "yaw")
    columns = ("successes", "paper", *(f"raw {a}" for a in angles), *(f"wrapped {a}" for a in angles))
    return Table(
        "Average errors, deg", (*_NAMES, *columns, "geodesic", "paper, roll / pitch / yaw"), tuple(rows)
    ).condensed(len(_NAMES))


def position_table(results: Results) -> Table:
    """Return the errors of the template's position, of successes and failures (Table 3)."""
    rows = []
    for result in results:
        for good in (True, False):
            chosen = result.rows.filter(pl.col("nn_success") == good)
            key = (good, result.cell.step_deg)
            prints = paper.POSITION_ERRORS.get(key) if result.cell.method == paper.TM else None
            rows.append(
                (
                    *_name(result.cell),
                    "success" if good else "failure",
                    str(chosen.height),
                    *(number(value, ".3f") for value in _columns(chosen, "centroid_error_m")),
                    _joined(prints, ".3f"),
                )
            )
    columns = ("outcome", "positions", "x", "y", "z", "paper, x / y / z")
    return Table("Average errors, m", (*_NAMES, *columns), tuple(rows)).condensed(len(_NAMES))


def cost_table(results: Results) -> Table:
    """Return f_CONV of failures and successes (Table 4)."""
    rows = []
    for result in results:
        good = result.rows.filter(pl.col("nn_success"))["nn_f_conv_m2"]
        bad = result.rows.filter(~pl.col("nn_success"))["nn_f_conv_m2"]
        values = (quantile(bad, 0.0), mean(bad), quantile(good, 1.0), mean(good))
        prints = paper.COSTS.get(paper.StepKey(result.cell.method, result.cell.step_deg))
        rows.append(
            (*_name(result.cell), *(number(value, ".4f") for value in values), _joined(prints, ".4f"))
        )
    columns = ("failure, least", "failure, mean", "success, greatest", "success, mean")
    return Table("f_CONV, m2", (*_NAMES, *columns, "paper, in the same order"), tuple(rows)).condensed(
        len(_NAMES)
    )


def _name(cell: TrajectoryCell) -> tuple[str, ...]:
    return in_world(cell.target, cell.world), cell.eq4, cell.centroid, cell.method, word(cell.step_deg)


def _pairs(results: Results) -> Iterator[tuple[Result, Result]]:
    """Yield template matching and its fast variant in the same cell."""

    def key(cell: TrajectoryCell) -> tuple[str, str, str, float]:
        return in_world(cell.target, cell.world), cell.eq4, cell.centroid, cell.step_deg

    fast = {key(result.cell): result for result in results if result.cell.method == paper.FAST_TM}
    for result in results:
        if result.cell.method == paper.TM and key(result.cell) in fast:
            yield result, fast[key(result.cell)]


def _columns(rows: pl.DataFrame, name: str) -> list[float]:
    """Return the means of the components of a column of lists; NaN without rows."""
    values = [value for value in rows[name].to_list() if value is not None]
    return np.mean(values, axis=0).tolist() if values else [float("nan")] * 3


def _ratio(numerator: float | None, denominator: float | None) -> float:
    return numerator / denominator if numerator is not None and denominator else float("nan")


def _joined(values: Sequence[float] | None, form: str) -> str:
    return " / ".join(f"{value:{form}}" for value in values) if values else ""
