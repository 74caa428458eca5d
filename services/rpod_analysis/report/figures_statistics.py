"""The report's figures of distributions: latency, processing time, and consistency (NEES, NIS)."""

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots
from scipy.special import gammainc

from rpod_analysis.report.downsampling import Line
from rpod_analysis.report.figures import ACCENT, BAD, QUIET, draw_limit, styled
from rpod_analysis.report.plot_data import PlotData
from rpod_analysis.scoring.row_store import Column
from rpod_analysis.scoring.score import NEES_95
from rpod_analysis.scoring.totals import RunTotals

_DECADES = (-3.0, 3.0)
_BINS_A_DECADE = 8


def timing_figure(totals: RunTotals) -> go.Figure | None:
    """Return a figure of latency and processing time, with median and 99 %; None if neither is known."""
    panels = [
        ("latency: stamp to publication", "latency [ms]", totals.latency_s),
        ("processing: last part received to publication", "processing [ms]", totals.processing_s),
    ]
    known = [panel for panel in panels if panel[2].count]
    if not known:
        return None
    figure = make_subplots(
        rows=1, cols=len(known), subplot_titles=[title for title, _, _ in known], horizontal_spacing=0.08
    )
    for col, (_, axis, seconds) in enumerate(known, start=1):
        end_s = max(3.0 * seconds.quantile(0.9), 1e-6)
        larger = seconds.max > end_s
        figure.update_xaxes(title_text=axis + ", longer ones in the last bar" * larger, row=1, col=col)
        figure.update_yaxes(title_text="frames", rangemode="tozero", row=1, col=col)
        _histogram(figure, seconds, min(end_s, seconds.max), col=col)
        for share, name in ((0.5, "median"), (0.99, "99 %")):
            at_ms = 1e3 * seconds.quantile(share)
            draw_limit(figure, "x", min(at_ms, 1e3 * end_s), QUIET, row=1, col=col)
            figure.add_annotation(
                text=f" {name} {at_ms:.3g} ms", showarrow=False, font={"size": 11},
                x=min(at_ms, 1e3 * end_s), y=1.0 - 0.1 * (share > 0.5), yref="y domain",
                yanchor="top", xanchor="left", row=1, col=col,
            )  # fmt: skip
    return styled(figure, height=290)


def consistency_figure(plot_data: PlotData, totals: RunTotals) -> go.Figure | None:
    """Return a figure of NEES and NIS with their 95 % bound, and distributions; None if neither is known."""
    panels = [
        ("NEES of the tracked frames", "NEES [-]", plot_data.nees, totals.nees),
        ("NIS of the measurements", "NIS [-]", plot_data.nis, totals.nis),
    ]
    known = [panel for panel in panels if panel[3].count]
    if not known:
        return None
    limit = NEES_95[totals.dof]
    lines = (
        f"95 % bound {limit} (red), expected mean {totals.dof} (grey)"  # in the panel they would cover points
    )
    figure = make_subplots(
        rows=len(known),
        cols=2,
        column_widths=[0.76, 0.24],
        shared_yaxes=True,
        shared_xaxes=True,
        subplot_titles=[text for title, *_ in known for text in (f"{title}: {lines}", "distribution")],
        horizontal_spacing=0.02,
        vertical_spacing=0.1,
    )
    for row, (_, axis, line, column) in enumerate(known, start=1):
        _over_time(figure, plot_data, line, row=row)
        _distribution(figure, column, dof=totals.dof, row=row)
        for col in (1, 2):
            draw_limit(figure, "y", limit, BAD, row=row, col=col)
            draw_limit(figure, "y", totals.dof, QUIET, row=row, col=col)
            figure.update_yaxes(type="log", row=row, col=col)
        figure.update_yaxes(title_text=axis, exponentformat="power", dtick=1, row=row, col=1)
    figure.update_xaxes(title_text="time [s]", row=len(known), col=1)
    figure.update_xaxes(title_text="share of frames per bin", row=len(known), col=2)
    return styled(figure, height=60 + 240 * len(known))


def _over_time(figure: go.Figure, plot_data: PlotData, line: Line, *, row: int) -> None:
    known = line.values > 0.0
    figure.add_trace(
        go.Scatter(
            x=plot_data.seconds(line.stamp_ns)[known],
            y=line.values[known],
            mode="markers",
            marker={"size": 3, "color": ACCENT, "opacity": 0.6},
            hovertemplate="%{x:.2f} s: %{y:.3g}<extra></extra>",
        ),
        row=row,
        col=1,
    )


def _distribution(figure: go.Figure, column: Column, *, dof: int, row: int) -> None:
    """Draw a histogram over the logarithm, with that of chi-squared."""
    low, high = _DECADES
    edges = 10.0 ** np.linspace(low, high, round((high - low) * _BINS_A_DECADE) + 1)
    ends = edges.copy()
    ends[[0, -1]] = 0.0, np.inf
    middle = np.sqrt(edges[1:] * edges[:-1])
    figure.add_trace(
        go.Scatter(
            x=column.counts(ends) / column.count,
            y=middle,
            mode="lines",
            line={"color": ACCENT, "width": 1, "shape": "vh"},
            fill="tozerox",
            hovertemplate="around %{y:.2g}: %{x:.3f}<extra></extra>",
        ),
        row=row,
        col=2,
    )
    expected = np.diff(gammainc(dof / 2.0, edges / 2.0))  # chi-squared; scipy.stats is slow to import
    line = {"color": QUIET, "width": 2}
    figure.add_trace(
        go.Scatter(x=expected, y=middle, mode="lines", line=line, hoverinfo="skip"), row=row, col=2
    )


def _histogram(figure: go.Figure, seconds: Column, end_s: float, *, col: int) -> None:
    """Draw a histogram between 0 and an end; longer durations are in the last bar."""
    bins = min(60, max(8, int(np.sqrt(seconds.count)) * 2))
    edges = np.linspace(0.0, np.nextafter(end_s, np.inf), bins + 1)
    counts = seconds.counts(np.append(edges[:-1], np.inf))
    figure.add_trace(
        go.Bar(
            x=1e3 * (edges[1:] + edges[:-1]) / 2.0,
            y=counts,
            width=1e3 * np.diff(edges),
            marker={"color": ACCENT, "line": {"width": 0}},
            hovertemplate="%{x:.3g} ms: %{y}<extra></extra>",
        ),
        row=1,
        col=col,
    )
