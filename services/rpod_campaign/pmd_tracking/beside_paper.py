"""The 2018 paper's tables and figures, with results of this project beside the printed values."""

from collections.abc import Iterator
from itertools import product

import plotly.graph_objects as go
import polars as pl

from rpod_campaign.engine.campaign import CellResult
from rpod_campaign.engine.report.charts import COLOURS, with_legend
from rpod_campaign.engine.report.content import Table
from rpod_campaign.engine.report.numbers import number, word
from rpod_campaign.papers import paper_2018 as paper
from rpod_campaign.pmd.report.summary import AXES, OTHER_AXES, Results, rms
from rpod_campaign.pmd.sequence import FRAME, SequenceCell
from rpod_campaign.pmd_tracking.pictures import picture

_ICP_COLUMNS = ("roll, deg", "pitch, deg", "yaw, deg", "x, m", "y, m", "z, m")
_FORMS = (".2f", ".2f", ".2f", ".3f", ".3f", ".3f")
_PAPER_SCENARIOS = (paper.OBLIQUE, paper.TUMBLING)
_GUESS = {"tracker": "estimate", "truth": "true pose"}
_SHOWN = (paper.ICP, paper.EPNP, "hybrid", "joint")
"""Methods in the figures of single images, if they were run."""


def table_2(results: Results) -> tuple[Table, ...]:
    """Return RMS errors and time of the paper's ICP over its radius (Table 2), in both choices of axes."""
    tables = []
    for scenario, through in product(_PAPER_SCENARIOS, ("tracker", "truth")):
        mine = [r for r in _of(results, scenario, through) if r.cell.method == paper.ICP]
        if mine:
            title = f"{scenario}, from the last image's {_GUESS[through]}"
            tables.append(_over_radius(mine, title, AXES))
            tables.append(
                _over_radius(mine, f"{title}: attitude in camera axes, position in target axes", OTHER_AXES)
            )
    return tuple(tables)


def _over_radius(results: Results, title: str, axes: tuple[str, ...]) -> Table:
    rows = []
    for result in results:
        cell = result.cell
        printed = paper.RMS.get((cell.scenario, cell.radius_px or 0))
        ours = rms(result.rows, axes).values()
        beside = printed[:6] if printed else (None,) * 6
        rows.append(
            (
                word(cell.radius_px),
                *(_beside(*pair) for pair in zip(ours, beside, _FORMS, strict=True)),
                _beside(result.summary["median_s"], printed.cpu_s if printed else None, ".3f"),
                f"{result.summary['lost']} of {result.summary['frames']}",
            )
        )
    return Table(title, ("radius, px", *_ICP_COLUMNS, "time, s", "lost"), tuple(rows))


def spikes_table(results: Results) -> tuple[Table, ...]:
    """Return the error norms of the images that the paper lists (Tables 3 and 4)."""
    tables = []
    for scenario, title in ((paper.OBLIQUE, "Table 3"), (paper.TUMBLING, "Table 4")):
        images = tuple(paper.NORMS[scenario, paper.ICP])
        rows = [(_technique(r.cell), *_spikes(r, images)) for r in _one_radius(results, scenario)]
        columns = ("method", *(f"image {image}, {unit}" for image in images for unit in ("deg", "m")))
        if rows:
            tables.append(Table(f"{title}: {scenario}, by image", columns, tuple(rows)))
    return tuple(tables)


def _spikes(result: CellResult[SequenceCell], images: tuple[int, ...]) -> Iterator[str]:
    printed = paper.NORMS.get((result.cell.scenario, result.cell.method), {})
    for image in images:
        rows = result.rows.filter((pl.col(FRAME) == image - 1) & (pl.col("trial") == 0))
        beside = printed.get(image)
        for name, form in (("attitude_deg", ".2f"), ("position_m", ".3f")):
            value = rows[name].item() if rows.height else None
            yield _beside(value, getattr(beside, name, None), form)


def error_figures(results: Results) -> tuple[go.Figure, ...]:
    """Return the error norms by image: ICP in both scenarios, then each with its techniques."""
    both = [r for s in _PAPER_SCENARIOS for r in _one_radius(results, s) if r.cell.method == paper.ICP]
    groups = [("Fig. 10", both)]
    for scenario, figure in ((paper.OBLIQUE, "Fig. 11"), (paper.TUMBLING, "Fig. 12")):
        groups.append((figure, [r for r in _one_radius(results, scenario) if r.cell.method in _SHOWN]))
    return tuple(
        _over_images(group, f"{title}: {what}", column)
        for title, group in groups
        if group
        for what, column in (("attitude error [deg]", "attitude_deg"), ("position error [m]", "position_m"))
    )


def _over_images(results: Results, y_title: str, column: str) -> go.Figure:
    figure = go.Figure()
    for index, result in enumerate(results):
        cell, colour = result.cell, COLOURS[index % len(COLOURS)]
        rows = result.rows.filter(pl.col("trial") == 0)
        name = f"{cell.scenario}, {_technique(cell)}"
        line = {"color": colour, "width": 1.6}
        images = (rows[FRAME] + 1).to_list()
        figure.add_trace(
            go.Scatter(x=images, y=rows[column].to_list(), mode="lines+markers", name=name, line=line)
        )
        printed = paper.NORMS.get((cell.scenario, cell.method), {})
        if printed:
            marker = {"symbol": "diamond-open", "size": 11, "color": colour, "line": {"width": 2}}
            values = [getattr(norms, column) for norms in printed.values()]
            figure.add_trace(
                go.Scatter(x=list(printed), y=values, mode="markers", name=f"{name}, printed", marker=marker)
            )
    figure.update_xaxes(title_text="image")
    figure.update_yaxes(title_text=y_title, rangemode="tozero")
    return with_legend(figure, height=340)


def pictures(results: Results) -> tuple[go.Figure, ...]:
    """Return the seventh depth and amplitude images with the wireframe at the estimates (Figs. 13 and 14)."""
    figures = []
    for scenario in _PAPER_SCENARIOS:
        shown = [r for r in _of(results, scenario, "tracker") if r.cell.method in _SHOWN]
        shown = [r for r in shown if r.cell.radius_px in (None, paper.RADIUS_PX)]
        figures += [picture(shown, number=paper.SEVENTH - 1)] if shown else []
    return tuple(figures)


def pictures_caption() -> str:
    """Return the caption of the pictures."""
    return (
        "Depth and amplitude, with the target's wireframe at the estimates and at the truth. Hidden lines "
        "are left out."
    )


def _of(results: Results, scenario: str, through: str) -> list[CellResult[SequenceCell]]:
    return [r for r in results if r.cell.scenario == scenario and r.cell.through == through]


def _one_radius(results: Results, scenario: str) -> list[CellResult[SequenceCell]]:
    """Return the results of a scenario with one radius; the paper's ICP from both guesses."""
    mine = [r for r in results if r.cell.scenario == scenario and r.cell.through in _GUESS]
    return [r for r in mine if r.cell.radius_px in (None, paper.RADIUS_PX)]


def _technique(cell: SequenceCell) -> str:
    """Return a method's name, with the source of its guess if that is not an estimate."""
    return cell.method if cell.through == "tracker" else f"{cell.method} from the true pose"


def _beside(ours: float | None, printed: float | None, form: str) -> str:
    """Return our value with the printed one, if there is one."""
    said = number(ours, form)
    return said if printed is None else f"{said} / {printed:g}"
