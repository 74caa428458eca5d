"""The report's figures over time, made with plotly: state and errors.

The colours of text, grid and background come from the page's style sheet.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from rpod_analysis.report.downsampling import Band, Line
from rpod_analysis.report.plot_data import PlotData
from rpod_analysis.scoring.score import BoolArray
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Mode, Source

ACCENT = "#2f7df6"
BAD = "#d9534f"
QUIET = "#8b949e"
SEVERAL = (ACCENT, "#e8833a", "#2aa876", "#a05fd6", "#d6487e", "#8a6d3b", "#17a2b8", "#6c757d")
"""Colours of the logs in a figure of several logs, in their order."""
PLOT = {"displaylogo": False, "responsive": True, "modeBarButtonsToRemove": ["lasso2d", "select2d"]}
"""Plotly's configuration of each figure in a page."""
_BAND = "rgba(139,148,158,0.22)"
_FAULT = "rgba(217,83,79,0.16)"
_MOST_BANDS = 100
"""Largest number of faults that are drawn."""
_MODES = {
    Mode.TRACKING: ACCENT,
    Mode.VERIFYING: "#9cc3fb",
    Mode.ACQUIRING: "#b8bfc7",
    Mode.LOST: BAD,
    Mode.COASTING: "#e8b04a",
}
_SOURCES = {
    Source.NONE: "rgba(139,148,158,0.30)",
    Source.LIDAR: "#2aa876",
    Source.PMD_DEPTH: "#a05fd6",
    Source.PMD_AMPLITUDE: "#e8833a",
    Source.PMD_JOINT: "#d6487e",
    Source.OTHER: "#8a6d3b",
}
_AXES = (
    ("roll", "pitch", "yaw"),
    ("x, right", "y, down", "z, boresight"),
)
_LIMITS = (10.0, 0.3)
"""Limits of attitude error, deg, and position error, m, beyond which an estimate is off the target."""


def error_figure(plot_data: PlotData) -> go.Figure:
    """Return a figure of attitude and position errors: magnitude, and each axis with its 3-sigma band."""
    titles = [title for pair in (("attitude", "position"), *zip(*_AXES, strict=True)) for title in pair]
    figure = make_subplots(
        rows=4,
        cols=2,
        shared_xaxes=True,
        subplot_titles=titles,
        vertical_spacing=0.055,
        horizontal_spacing=0.08,
    )
    columns = (
        (plot_data.angle_deg, plot_data.attitude_deg, plot_data.sigma_deg, "°"),
        (plot_data.distance_m, plot_data.position_m, plot_data.sigma_m, "m"),
    )
    for col, (size, axes, sigmas, unit) in enumerate(columns, start=1):
        _line(figure, plot_data, size, unit, row=1, col=col)
        if size.values.max(initial=0.0) > 0.6 * _LIMITS[col - 1]:
            draw_limit(figure, "y", _LIMITS[col - 1], BAD, row=1, col=col)
        for row, (axis, sigma) in enumerate(zip(axes, sigmas, strict=True), start=2):
            _band(figure, plot_data, sigma, unit, row=row, col=col)
            _line(figure, plot_data, axis, unit, row=row, col=col)
            reach = _reach(axis.values, sigma.values)
            figure.update_yaxes(range=[-reach, reach], row=row, col=col)
        for row in range(1, 5):
            figure.update_yaxes(title_text=f"error [{unit}]", exponentformat="none", row=row, col=col)
            draw_faults(figure, plot_data, row=row, col=col, named=row == 1)
        figure.update_yaxes(rangemode="tozero", row=1, col=col)
        figure.update_xaxes(title_text="time [s]", row=4, col=col)
    return styled(figure, height=860)


def state_figure(plot_data: PlotData) -> go.Figure:
    """Return a figure of state and source as bands, rejected frames as ticks, and the target's distance."""
    figure = make_subplots(
        rows=3, cols=1, shared_xaxes=True, row_heights=[0.13, 0.13, 0.74], vertical_spacing=0.03
    )
    _draw_intervals(figure, plot_data, plot_data.mode, _MODES, row=1)
    _draw_intervals(figure, plot_data, plot_data.source, _SOURCES, row=2)
    time_s = plot_data.seconds(plot_data.rejected.stamp_ns)
    figure.add_trace(
        go.Scatter(
            x=time_s,
            y=np.full(time_s.size, 0.5),
            mode="markers",
            marker={"symbol": "line-ns-open", "size": 14, "color": "#111"},
            name="rejected",
            showlegend=bool(time_s.size),
            text=plot_data.reasons,
            hovertemplate="%{x:.2f} s: %{text}<extra>rejected</extra>",
        ),
        row=1,
        col=1,
    )
    for line, name, style in (
        (plot_data.true_range_m, "truth", {"color": QUIET, "width": 4}),
        (plot_data.range_m, "estimate", {"color": ACCENT, "width": 1.6}),
    ):
        if line.values.size:
            x, y = with_gaps(plot_data.seconds(line.stamp_ns), line.values)
            hover = "%{x:.2f} s: %{y:.3f} m<extra></extra>"
            figure.add_trace(
                go.Scatter(x=x, y=y, mode="lines", name=name, line=style, hovertemplate=hover), row=3, col=1
            )
    for row in range(1, 4):
        draw_faults(figure, plot_data, row=row, col=1, named=row == 3)
    for row, title in ((1, "state"), (2, "source")):
        axis = {"range": [0, 1], "fixedrange": True, "showgrid": False, "showticklabels": False}
        figure.update_yaxes(title_text=title, zeroline=False, **axis, row=row, col=1)
        figure.update_xaxes(showgrid=False, row=row, col=1)
    figure.update_yaxes(title_text="distance [m]", row=3, col=1)
    figure.update_xaxes(title_text="time [s]", row=3, col=1)
    figure.update_layout(
        barmode="overlay", legend={"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0}
    )
    return styled(figure, height=380, top=44, legend=True)


def _reach(error: FloatArray, sigma: FloatArray) -> float:
    """Return the half height of a panel: all errors fit in, and the band most of the time."""
    usual = float(np.median(sigma)) if sigma.size else 0.0
    return max(1.15 * float(np.abs(error).max(initial=0.0)), 3.5 * usual, 1e-9)


def draw_limit(figure: go.Figure, axis: str, value: float, colour: str, *, row: int, col: int) -> None:
    """Draw a dotted line at a value of an axis, across the whole panel."""
    across = "y" if axis == "x" else "x"
    ends = {f"{axis}0": value, f"{axis}1": value, f"{across}0": 0, f"{across}1": 1}
    line = {"color": colour, "width": 1, "dash": "dot"}
    reference = {f"{across}ref": f"{across} domain"}
    figure.add_shape(**ends, **reference, type="line", line=line, row=row, col=col)


def draw_faults(figure: go.Figure, plot_data: PlotData, *, row: int, col: int, named: bool) -> None:
    """Draw a band across a panel for each fault that was injected, with its name if wanted."""
    for fault in plot_data.faults[:_MOST_BANDS]:
        ends_ns = fault.begin_ns, plot_data.end_ns if fault.end_ns is None else fault.end_ns
        x0, x1 = plot_data.seconds(np.array(ends_ns)).tolist()
        name = f"{fault.fault} {fault.where}".strip()
        figure.add_shape(
            type="rect", x0=x0, x1=x1, y0=0, y1=1, yref="y domain", fillcolor=_FAULT, line={"width": 0},
            layer="below", row=row, col=col,
        )  # fmt: skip
        if named:
            figure.add_annotation(
                x=x0, y=1, yref="y domain", text=name, showarrow=False, xanchor="left", yanchor="top",
                row=row, col=col,
            )  # fmt: skip


def _line(figure: go.Figure, plot_data: PlotData, line: Line, unit: str, *, row: int, col: int) -> None:
    x, y = with_gaps(plot_data.seconds(line.stamp_ns), line.values)
    figure.add_trace(
        go.Scatter(
            x=x,
            y=y,
            mode="lines+markers",
            line={"color": ACCENT, "width": 1.4},
            marker={"size": 5 if x.size <= 100 else np.where(_alone(y), 5, 0), "line": {"width": 0}},
            hovertemplate=f"%{{x:.2f}} s: %{{y:.4g}} {unit}<extra></extra>",
        ),
        row=row,
        col=col,
    )


def _alone(values: FloatArray) -> BoolArray:
    """Return which points have no neighbour, so that a line would not show them."""
    known = np.pad(np.isfinite(values), 1)
    alone: BoolArray = known[1:-1] & ~known[:-2] & ~known[2:]
    return alone


def _band(figure: go.Figure, plot_data: PlotData, sigma: Line, unit: str, *, row: int, col: int) -> None:
    if not (sigma.values > 0.0).any():
        return
    x, y = with_gaps(plot_data.seconds(sigma.stamp_ns), 3.0 * sigma.values)
    breaks = np.flatnonzero(np.isnan(y))
    pieces = [part[np.isfinite(y[part])] for part in np.split(np.arange(y.size), breaks)]
    figure.add_trace(
        go.Scatter(
            x=np.concatenate([part for piece in pieces for part in (x[piece], x[piece][::-1], [np.nan])]),
            y=np.concatenate([part for piece in pieces for part in (y[piece], -y[piece][::-1], [np.nan])]),
            fill="toself",
            fillcolor=_BAND,
            line={"width": 0},
            mode="lines",
            name=f"3 sigma [{unit}]",
            hoverinfo="skip",
        ),
        row=row,
        col=col,
    )


def with_gaps(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a line with gaps where there are no estimates."""
    if time_s.size < 3:
        return time_s, values
    step_s = np.diff(time_s)
    pauses = np.flatnonzero(step_s > max(5.0 * float(np.median(step_s)), 0.3)) + 1
    return np.insert(time_s, pauses, time_s[pauses]), np.insert(values, pauses, np.nan)


def _draw_intervals(
    figure: go.Figure, plot_data: PlotData, band: Band, colours: Mapping[Any, str], *, row: int
) -> None:
    """Draw a bar for each interval of equal value; the bars of one value are one trace."""
    starts_s = plot_data.seconds(band.start_ns)
    ends_s = np.append(starts_s[1:], plot_data.seconds(np.array([band.end_ns])))[: starts_s.size]
    for value, colour in colours.items():
        mine = band.values == value
        if mine.any():
            figure.add_trace(
                go.Bar(
                    orientation="h",
                    base=starts_s[mine],
                    x=(ends_s - starts_s)[mine],
                    y=np.full(mine.sum(), 0.5),
                    width=0.9,
                    marker={"color": colour, "line": {"width": 0}},
                    name=value.name,
                    hovertemplate=f"{value.name}<br>%{{base:.2f}} s for %{{x:.2f}} s<extra></extra>",
                ),
                row=row,
                col=1,
            )


def styled(figure: go.Figure, *, height: int, top: int = 28, legend: bool = False) -> go.Figure:
    """Apply the style of the reports to a figure, and return it."""
    axis: dict[str, Any] = {
        "gridcolor": "rgba(139,148,158,0.22)",
        "zerolinecolor": "rgba(139,148,158,0.55)",
        "title": {"standoff": 6, "font": {"size": 12}},
        "tickfont": {"size": 11},
    }
    figure.update_xaxes(**axis)
    figure.update_yaxes(**axis)
    figure.update_annotations(font={"size": 13})
    return figure.update_layout(
        template="none",
        showlegend=legend,
        height=height,
        margin={"l": 58, "r": 12, "t": top, "b": 44},
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
        font={"family": "system-ui, sans-serif", "size": 12, "color": QUIET},
        modebar={"bgcolor": "rgba(0,0,0,0)", "orientation": "v"},
        hoverlabel={"font": {"family": "system-ui, sans-serif"}},
    )
