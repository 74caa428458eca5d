"""Tables and curves that the camera's campaigns share."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
import polars as pl

from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.report.charts import curve_figure, distinct
from rpod_campaign.engine.report.content import Table
from rpod_campaign.engine.report.numbers import NONE, millimetres, milliseconds, number, percent, word
from rpod_campaign.pmd.report.summary import AXES, OTHER_AXES, Results, rms
from rpod_campaign.pmd.sequence import SequenceCell

NAMES = ("scenario", "case", "frames", "through", "method", "radius, px")
"""Columns of ``name_of``."""
_UNITS = ("roll, deg", "pitch, deg", "yaw, deg", "x, mm", "y, mm", "z, mm")
LOST = (
    "A frame is lost if the tracker gives no pose, so that the last one is kept as the next guess, or if the "
    "error of the estimate exceeds 10 deg or 0.3 m. RMS and greatest error include lost frames. Times are "
    "processor times of one thread."
)


def name_of(cell: SequenceCell) -> tuple[str, ...]:
    """Return the texts that identify a sequence in a table."""
    return (
        *(cell.scenario, cell.case or "-", cell.frames, cell.through, cell.method),
        word(cell.radius_px),
    )


def label(cell: SequenceCell, among: Sequence[SequenceCell]) -> str:
    """Return the text that distinguishes a cell from the others, one line."""
    return distinct(_line(cell), [_line(other) for other in among]) or cell.method


def _line(cell: SequenceCell) -> tuple[str, ...]:
    return (*name_of(cell)[:-1], NONE if cell.radius_px is None else f"{cell.radius_px} px")


def overview(results: Results) -> tuple[Table, Table]:
    """Return the tables of errors, and of lost frames, time and consistency."""
    return _errors(results), _conduct(results)


def _errors(results: Results) -> Table:
    rows = []
    for result in results:
        s = result.summary
        rows.append(
            (
                *name_of(result.cell),
                str(s["frames"]),
                *_six(s["rms"]),
                number(s["norms"]["attitude_deg"], ".2f"),
                millimetres(s["norms"]["position_m"]),
                number(s["max"]["attitude_deg"], ".2f"),
                millimetres(s["max"]["position_m"], ".0f"),
            )
        )
    columns = ("images", *_UNITS, "norm, deg", "norm, mm", "greatest, deg", "greatest, mm")
    return Table("RMS and greatest errors", (*NAMES, *columns), tuple(rows)).condensed(len(NAMES))


def _conduct(results: Results) -> Table:
    rows = []
    for result in results:
        s = result.summary
        rows.append(
            (
                *name_of(result.cell),
                str(s["frames"]),
                *(str(s[name]) for name in ("lost", "lost_without_pose", "lost_off_target")),
                percent(s["depth_share"]),
                milliseconds(s["median_s"]),
                milliseconds(s["p95_s"]),
                number(s["nees_mean"], ".1f"),
                number(s["nees_dof"], "g"),
                number(s["nees_share_in_95"], ".2f"),
            )
        )
    columns = (
        *("images", "lost", "without pose", "off", "target's pixels with depth"),
        *("median, ms", "p95, ms", "mean NEES", "of", "inside 95 %"),
    )
    return Table("Lost frames, time, consistency", (*NAMES, *columns), tuple(rows)).condensed(len(NAMES))


def other_axes(results: Results) -> Table:
    """Return the RMS errors with attitude in the sensor's axes and position in the target's."""
    rows = [(*name_of(result.cell), *_six(rms(result.rows, OTHER_AXES))) for result in results]
    return Table(
        "RMS, attitude in the camera's axes, position in the target's", (*NAMES, *_UNITS), tuple(rows)
    ).condensed(len(NAMES))


def by_range(results: Results) -> Table:
    """Return the RMS norms in range bins of one metre."""
    bins = sorted({int(range_m) for result in results for range_m in result.rows["range_m"].to_list()})
    rows = []
    for result in results:
        found = [
            result.rows.filter((pl.col("range_m") >= low) & (pl.col("range_m") < low + 1)) for low in bins
        ]
        rows.append((*name_of(result.cell), *(_norms(part) for part in found)))
    columns = tuple(f"{low} to {low + 1} m" for low in bins)
    return Table("RMS by range, deg / mm", (*NAMES, *columns), tuple(rows)).condensed(len(NAMES))


def errors_over_range(results: Results) -> tuple[go.Figure, ...]:
    """Return the error norms over the range, as medians over trials."""
    figures, cells = [], [result.cell for result in results]
    for column, title, scale in (
        ("attitude_deg", "attitude error [deg]", 1.0),
        ("position_m", "position error [mm]", 1e3),
    ):
        curves = {}
        for result in results:
            medians = pl.col("range_m", column).median()
            rows = result.rows.group_by("frame").agg(medians).sort("range_m")
            curves[label(result.cell, cells)] = (
                rows["range_m"].to_list(),
                (scale * rows[column]).to_list(),
            )
        figures.append(curve_figure(curves, x_title="range [m]", y_title=title, log_y=True))
    return tuple(figures)


def _six(values: dict[str, float | None]) -> tuple[str, ...]:
    angles = (number(values[axis], ".2f") for axis in AXES[:3])
    return (*angles, *(millimetres(values[axis]) for axis in AXES[3:]))


def _norms(rows: pl.DataFrame) -> str:
    if rows.is_empty():
        return "-"
    angle, distance = (
        float(np.sqrt((rows[name].to_numpy() ** 2).mean())) for name in ("attitude_deg", "position_m")
    )
    return f"{angle:.2f} / {1e3 * distance:.0f}"


def first(results: Results, **wanted: object) -> CellResult[SequenceCell] | None:
    """Return the first result whose cell has these fields; None if there is none."""
    return next(
        (r for r in results if all(getattr(r.cell, name) == value for name, value in wanted.items())), None
    )
