"""The 2015 paper's figures over the trajectory, with results of this project."""

from collections.abc import Sequence

import plotly.graph_objects as go
import polars as pl

from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.report.charts import curve_figure, distinct, rate_figure
from rpod_campaign.engine.report.numbers import in_world
from rpod_campaign.engine.report.statistics import Rate
from rpod_campaign.lidar_trajectory.tables import success
from rpod_campaign.lidar_trajectory.trial import TrajectoryCell
from rpod_campaign.papers import paper_2015 as paper

Results = Sequence[CellResult[TrajectoryCell]]

_PRINTED_STEP_DEG = 30.0
"""Template step of Fig. 9, deg."""


def figures_over_time(results: Results) -> tuple[go.Figure, ...]:
    """Return the range over time (Fig. 5), and f_CONV over time at 30 deg (Fig. 9)."""
    if not results:
        return ()
    first = results[0]
    minutes = (first.rows["time_s"] / 60.0).to_list()
    ranges = curve_figure(
        {in_world(first.cell.target, first.cell.world): (minutes, first.rows["range_m"].to_list())},
        x_title="time [min]",
        y_title="range [m]",
        markers=True,
    )
    shown = next((r for r in results if _of_figure_9(r.cell)), first)
    clouds = {}
    for name, good in (("success", True), ("failure", False)):
        rows = shown.rows.filter(pl.col("nn_success") == good)
        clouds[name] = ((rows["time_s"] / 60.0).to_list(), rows["nn_f_conv_m2"].to_list())
    about = f"f_CONV [m2], {in_world(shown.cell.target, shown.cell.world)}, {shown.cell.step_deg:g} deg"
    costs = curve_figure(clouds, x_title="time [min]", y_title=about, markers=True, log_y=True)
    return ranges, costs


def figures_over_steps(results: Results) -> tuple[go.Figure, ...]:
    """Return success over the step with both ICPs (Figs. 6 and 7)."""
    lines: dict[str, dict[float, Rate]] = {}
    names = [_line(result.cell) for result in results]
    for result, line in zip(results, names, strict=True):
        cell, about = result.cell, distinct(line, names) or result.cell.method
        for icp in ("nn", "ns") if cell.method == paper.TM else ("nn",):
            name = f"{about}, {icp.upper()}"
            lines.setdefault(name, {})[cell.step_deg] = success(result, icp)
    return (rate_figure(lines, x_title="template step [deg]"),)


def _line(cell: TrajectoryCell) -> tuple[str, ...]:
    return (
        in_world(cell.target, cell.world),
        f"Eq. 4 {cell.eq4}",
        f"centroid {cell.centroid}",
        cell.method,
    )


def _of_figure_9(cell: TrajectoryCell) -> bool:
    return cell.method == paper.TM and cell.step_deg == _PRINTED_STEP_DEG
