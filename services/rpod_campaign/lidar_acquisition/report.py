"""``lidar-acquisition``: random attitudes at fixed ranges (2015 paper, section 4.3, Fig. 8)."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import polars as pl

from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.report.charts import rate_figure
from rpod_campaign.engine.report.content import Section, Table
from rpod_campaign.engine.report.numbers import NONE, in_world, milliseconds, number, percent, printed, word
from rpod_campaign.engine.report.statistics import Rate, mean, quantile, rate_of
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.scores import RIGHT_M, RIGHT_SHARE, SUCCESS_DEG, ambiguous, wrong
from rpod_campaign.lidar_acquisition.trial import AcquisitionCell
from rpod_campaign.papers import paper_2015 as paper

Results = Sequence[CellResult[AcquisitionCell]]


def summarise(cell: AcquisitionCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return the summary of a cell; ``wrong_accepted`` and ``right_rejected`` are numbers of trials."""
    discarded = int(rows["discarded"].sum())
    return {
        **asdict(cell),
        "trials": rows.height,
        "discarded_share": discarded / (discarded + rows.height) if rows.height else None,
        "templates": rows["templates"].max(),
        "excluded_share": mean(rows["excluded_share"]),
        **rate_of(rows, "success").named("success_rate"),
        "median_s": quantile(rows["acquire_s"], 0.5),
        "p95_s": quantile(rows["acquire_s"], 0.95),
        "wrong_accepted": int((wrong(rows, cached_target(cell.target)) & rows["accepted"]).sum()),
        "right_rejected": int((rows["success"] & ~rows["accepted"]).sum()),
        **ambiguous(rows),
    }


def sections(results: Results) -> list[Section]:
    """Return the sections of the report: success over range and step, then times and answers."""
    note = (
        f"Success: attitude within {SUCCESS_DEG:g} deg after refinement, with its 95 % Wilson interval. "
        "Random poses with a part of the target nearer than 2 m to the sensor are replaced; discarded is "
        f"their share. The paper's column has the values that {paper.CITATION} prints; it is blank if there "
        "is none. The paper does not state its target's sizes, so that only trends are comparable. For a "
        f"target that is no shipped one, the position also decides: success is within {SUCCESS_DEG:g} deg "
        f"and {100.0 * RIGHT_SHARE:g} % of its longest side, which replace {RIGHT_M:g} m below."
    )
    return [
        Section("Success", note, (_success_table(results), *_loss_tables(results)), _figures(results)),
        Section(
            "Answers and time",
            "Time of the acquisition up to its answer, one thread; for template matching, of the search, "
            "with its ICP in another column. Wrong accepted: accepted with an error of 3 deg or 0.3 m or "
            "more, out of all with such an error. Right rejected: out of the successes. Ambiguous: answers "
            "that begin no track because other poses explain the scan too.",
            (_answer_table(results),),
        ),
    ]


def _name(cell: AcquisitionCell) -> tuple[str, ...]:
    step = word(cell.step_deg)
    return (
        in_world(cell.target, cell.world, cell.surroundings),
        cell.method,
        step,
        word(cell.centroid),
        word(cell.matcher),
        cell.eq4,
        cell.sampling,
        word(cell.range_m),
    )


_NAMES = ("target", "method", "step, deg", "centroid", "matcher", "Eq. 4", "sampling", "range, m")


def _success_table(results: Results) -> Table:
    rows = [
        (
            *_name(result.cell),
            str(result.rows.height),
            str(rate_of(result.rows, "success")),
            _paper_success(result.cell),
            percent(result.summary["discarded_share"]),
            number(mean(result.rows["returns"]), ".0f"),
            printed(paper.RETURNS, result.cell.range_m),
        )
        for result in results
    ]
    columns = ("trials", "success", "paper", "discarded", "mean returns", "paper, returns")
    return Table("Success rate", (*_NAMES, *columns), tuple(rows)).condensed(len(_NAMES))


def _paper_success(cell: AcquisitionCell) -> str:
    key = paper.RangeKey(cell.method, cell.range_m, cell.step_deg or 0.0)
    return printed(paper.RANDOM_SUCCESS, key) if cell.sampling == "euler" else ""


def _answer_table(results: Results) -> Table:
    rows = []
    for result in results:
        frame, summary = result.rows, result.summary
        off = wrong(frame, cached_target(result.cell.target))
        rows.append(
            (
                *_name(result.cell),
                word(summary["templates"]),
                percent(summary["excluded_share"]),
                milliseconds(summary["median_s"]),
                milliseconds(summary["p95_s"]),
                milliseconds(quantile(frame["icp_s"], 0.5)),
                f"{summary['wrong_accepted']} of {int(off.sum())}",
                f"{summary['right_rejected']} of {int(frame['success'].sum())}",
                str(summary["ambiguous"]),
            )
        )
    columns = (
        "templates",
        "excluded",
        "median, ms",
        "p95, ms",
        "ICP, ms",
        "wrong accepted",
        "right rejected",
        "ambiguous",
    )
    return Table("Answers and time", (*_NAMES, *columns), tuple(rows)).condensed(len(_NAMES))


def _loss_tables(results: Results) -> tuple[Table, ...]:
    """Return the success that the fast variant loses against template matching in the same cells."""
    rates = {result.cell: rate_of(result.rows, "success") for result in results}
    rows = []
    for cell, share in rates.items():
        if cell.method != paper.TM:
            continue
        other = next(
            (
                c
                for c in rates
                if c.method == paper.FAST_TM
                and (_name(c)[0], *_name(c)[2:]) == (_name(cell)[0], *_name(cell)[2:])
            ),
            None,
        )
        if other is not None:
            loss = share.value - rates[other].value
            rows.append(
                (
                    in_world(cell.target, cell.world, cell.surroundings),
                    *_name(cell)[2:],
                    number(loss, "+.3f"),
                    printed(paper.RANDOM_LOSS, (cell.range_m, cell.step_deg)),
                )
            )
    columns = ("target", *_NAMES[2:], "loss", "paper")
    return (
        (Table("Success lost by the fast variant", columns, tuple(rows)).condensed(len(columns) - 2),)
        if rows
        else ()
    )


def _figures(results: Results) -> tuple[Any, ...]:
    """Return success over range, and over the step at each range if there are several."""
    by_range: dict[str, dict[float, Rate]] = {}
    by_step: dict[str, dict[float, Rate]] = {}
    marks: dict[str, dict[float, float]] = {}
    for result in results:
        cell, share = result.cell, rate_of(result.rows, "success")
        about = ", ".join(_name(cell)[k] for k in (0, 1, 3, 4, 5, 6) if _name(cell)[k] != NONE)
        by_range.setdefault(about + (f", {cell.step_deg:g} deg" if cell.step_deg else ""), {})[
            cell.range_m
        ] = share
        if cell.step_deg:
            name = f"{about}, {cell.range_m:g} m"
            by_step.setdefault(name, {})[cell.step_deg] = share
            text = _paper_success(cell)
            if text:
                marks.setdefault(name, {})[cell.step_deg] = float(text)
    figures = [rate_figure(by_range, x_title="range [m]")]
    if any(len(points) > 1 for points in by_step.values()):
        figures.append(rate_figure(by_step, x_title="template step [deg]", printed=marks))
    return tuple(figures)
