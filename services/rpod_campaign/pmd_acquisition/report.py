"""``pmd-acquisition``: the mock-up in one frame at 3 to 6 m, without a guess and near a wrong one."""

from collections.abc import Sequence
from typing import Any

import polars as pl

from rpod_campaign.engine.campaign import CellResult, described
from rpod_campaign.engine.report.charts import distinct, distribution_figure
from rpod_campaign.engine.report.content import Section, Table
from rpod_campaign.engine.report.numbers import NONE, in_world, millimetres, milliseconds, number
from rpod_campaign.engine.report.statistics import quantile, rate_of
from rpod_campaign.pmd.poses import FRONT_DEG, SUCCESS_DEG, SUCCESS_M
from rpod_campaign.pmd.scene import scenario_of
from rpod_campaign.pmd_acquisition.trial import WIDE_DEG, WIDE_M, AcquisitionCell

Results = Sequence[CellResult[AcquisitionCell]]


def summarise(cell: AcquisitionCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return the summary of a cell; ``wrong_accepted`` and ``right_refused`` are numbers of trials.

    An ambiguity by an exact symmetry begins a track and is not counted.
    """
    unsure = rows.filter((pl.col("verdict") == "ambiguous") & ~pl.col("accepted"))
    good = rows.filter("success")
    return {
        **described(cell),
        "trials": rows.height,
        **rate_of(rows, "success").named("success_rate"),
        "median_deg": quantile(good["attitude_deg"], 0.5),
        "median_m": quantile(good["position_m"], 0.5),
        "median_s": quantile(rows["acquire_s"], 0.5),
        "p95_s": quantile(rows["acquire_s"], 0.95),
        "accepted": int(rows["accepted"].sum()),
        "wrong_accepted": int((rows["accepted"] & ~rows["success"]).sum()),
        "right_refused": int((rows["success"] & ~rows["accepted"]).sum()),
        "ambiguous": unsure.height,
        "ambiguous_with_truth": int(unsure["right_hypothesis"].sum()),
    }


def sections(results: Results) -> list[Section]:
    """Return the sections of the report."""
    note = (
        f"One frame for each trial, the scenario's camera and sun. Success: within {SUCCESS_DEG:g} deg and "
        f"{1e2 * SUCCESS_M:g} cm, accepted or not, with 95 % Wilson intervals. front: within "
        f"{FRONT_DEG:g} deg of the front, any roll; all: attitudes uniform on SO(3). wide: a search near a "
        f"guess with an error of {WIDE_DEG:g} deg and {WIDE_M:g} m in random directions. Times are processor "
        "times of one thread."
    )
    return [Section("Acquisition", note, (_table(results), *_refusals(results)), _figures(results))]


def _table(results: Results) -> Table:
    rows = [
        (
            *_name(result.cell),
            str(result.rows.height),
            str(rate_of(result.rows, "success")),
            number(result.summary["median_deg"], ".2f"),
            millimetres(result.summary["median_m"]),
            milliseconds(result.summary["median_s"]),
            milliseconds(result.summary["p95_s"]),
            *(
                str(result.summary[name])
                for name in ("wrong_accepted", "right_refused", "ambiguous", "ambiguous_with_truth")
            ),
        )
        for result in results
    ]
    columns = (
        *("trials", "success", "median, deg", "median, mm", "median, ms", "p95, ms"),
        *("wrong accepted", "right refused", "ambiguous", "truth among them"),
    )
    return Table("Success and time", (*_NAMES, *columns), tuple(rows)).condensed(len(_NAMES))


def _refusals(results: Results) -> tuple[Table, ...]:
    """Return the table of the reasons for rejection, if any, counted without the numbers in them."""
    rows: list[tuple[str, ...]] = []
    for result in results:
        words = result.rows.filter(pl.col("reason") != "").select(
            pl.col("reason").str.replace_all(r"\d+(\.\d+)?", "_")
        )
        counts = words["reason"].value_counts(sort=True).iter_rows()
        rows += [(*_name(result.cell), str(count), reason) for reason, count in counts]
    if not rows:
        return ()
    return (Table("Why refused", (*_NAMES, "trials", "reason"), tuple(rows)).condensed(len(_NAMES)),)


_NAMES = ("scenario", "target", "model", "view", "start", "method", "range, m")


def _name(cell: AcquisitionCell) -> tuple[str, ...]:
    return (
        scenario_of(cell.document).name,
        cell.target,
        cell.model or NONE,
        in_world(cell.view, cell.world, cell.surroundings),
        cell.start,
        cell.method,
        f"{cell.range_m[0]:g} to {cell.range_m[1]:g}",
    )


def _figures(results: Results) -> tuple[Any, ...]:
    """Return the distribution of the attitude error in each cell."""
    lines = [_line(result.cell) for result in results]
    errors_deg = {
        distinct(line, lines) or result.cell.method: result.rows["attitude_deg"]
        for result, line in zip(results, lines, strict=True)
    }
    return (distribution_figure(errors_deg),)


def _line(cell: AcquisitionCell) -> tuple[str, ...]:
    *names, range_m = _name(cell)
    return (*names, f"{range_m} m")
