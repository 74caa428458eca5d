"""The figures that the campaigns share. Colours of text, grid and paper come from the page's style sheet."""

from collections.abc import Mapping, Sequence
from typing import Any

import plotly.graph_objects as go
import polars as pl

from rpod_analysis.report.figures import ACCENT, BAD, QUIET, styled
from rpod_campaign.engine.report.numbers import NONE
from rpod_campaign.engine.report.statistics import Rate

COLOURS = (ACCENT, "#e8973a", "#3aa876", "#a46de0", BAD, "#5bb8c9", "#c96f9e", QUIET)
_SYMBOLS = ("circle", "diamond-open", "cross-thin-open", "square-open", "triangle-up-open")
"""Symbols of point clouds; the next one follows where the colours begin again."""
_DASHES = ("solid", "dash", "dot")


def distinct(name: Sequence[str], among: Sequence[Sequence[str]]) -> str:
    """Return the parts of a name that are not equal in all names, on one line; empty if all are equal."""
    differs = [len({other[k] for other in among}) > 1 for k in range(len(name))]
    return ", ".join(part for part, shown in zip(name, differs, strict=True) if shown and part != NONE)


def rate_figure(
    lines: Mapping[str, Mapping[float, Rate]],
    *,
    x_title: str,
    printed: Mapping[str, Mapping[float, float]] | None = None,
) -> go.Figure:
    """Return a figure of success over a parameter, with Wilson intervals; open diamonds are the paper's."""
    figure = go.Figure()
    for index, (name, points) in enumerate(lines.items()):
        colour = COLOURS[index % len(COLOURS)]
        x = sorted(points)
        rates = [points[value] for value in x]
        figure.add_trace(
            go.Scatter(
                x=x,
                y=[rate.value for rate in rates],
                error_y={
                    "array": [rate.high - rate.value for rate in rates],
                    "arrayminus": [rate.value - rate.low for rate in rates],
                    "thickness": 1,
                    "width": 3,
                },
                mode="lines+markers",
                name=name,
                line={"color": colour, "width": 1.6},
                hovertemplate=f"{name}<br>%{{x:g}}: %{{y:.3f}}<extra></extra>",
            )
        )
        marks = (printed or {}).get(name)
        if marks:
            figure.add_trace(
                go.Scatter(
                    x=list(marks),
                    y=list(marks.values()),
                    mode="markers",
                    name=f"{name}, paper",
                    marker={"symbol": "diamond-open", "size": 11, "color": colour, "line": {"width": 2}},
                )
            )
    figure.update_xaxes(title_text=x_title)
    figure.update_yaxes(title_text="success rate")
    return with_legend(figure, height=380)


def curve_figure(
    curves: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    *,
    x_title: str,
    y_title: str,
    markers: bool = False,
    log_x: bool = False,
    log_y: bool = False,
    points: Mapping[str, tuple[float, float]] | None = None,
    limits: Mapping[str, tuple[Sequence[float], Sequence[float]]] | None = None,
) -> go.Figure:
    """Return a figure of named curves or point clouds, with single points as crosses, and limits as lines."""
    figure = go.Figure()
    for index, (name, (x, y)) in enumerate(curves.items()):
        figure.add_trace(
            go.Scatter(
                x=list(x),
                y=list(y),
                mode="markers" if markers else "lines",
                name=name,
                line={"color": COLOURS[index % len(COLOURS)], "width": 1.6},
                marker={
                    "color": COLOURS[index % len(COLOURS)],
                    "symbol": _SYMBOLS[index // len(COLOURS) % len(_SYMBOLS)],
                    "size": 5,
                },
            )
        )
    for index, (name, (x, y)) in enumerate((limits or {}).items()):
        line = {"color": QUIET, "width": 1.2, "dash": _DASHES[index % len(_DASHES)]}
        figure.add_trace(go.Scatter(x=list(x), y=list(y), mode="lines", name=name, line=line))
    for index, (name, point) in enumerate((points or {}).items()):
        marker = {"symbol": "x", "size": 10, "color": COLOURS[index % len(COLOURS)]}
        figure.add_trace(go.Scatter(x=[point[0]], y=[point[1]], mode="markers", name=name, marker=marker))
    figure.update_xaxes(title_text=x_title, **_scale(log_x))
    figure.update_yaxes(title_text=y_title, **_scale(log_y))
    return with_legend(figure, height=360)


def distribution_figure(errors_deg: Mapping[str, pl.Series]) -> go.Figure:
    """Return the distributions of attitude errors, by name; a null is a trial without a pose."""
    curves = {}
    for name, errors in errors_deg.items():
        known = errors.drop_nulls().sort().to_list()
        curves[name] = (known, [(k + 1) / errors.len() for k in range(len(known))])
    return curve_figure(curves, x_title="attitude error [deg]", y_title="share below", log_x=True)


def _scale(logarithmic: bool) -> dict[str, Any]:
    return {"type": "log", "dtick": 1, "exponentformat": "power"} if logarithmic else {}


def with_legend(figure: go.Figure, *, height: int) -> go.Figure:
    """Return the styled figure with its legend above it."""
    figure.update_layout(legend={"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0})
    return styled(figure, height=height, top=64, legend=True)
