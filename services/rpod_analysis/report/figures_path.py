"""The path of the target in the chaser's axes: in three dimensions, and in two projections."""

from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from rpod_analysis.report.downsampling import Samples
from rpod_analysis.report.figures import ACCENT, QUIET, styled, with_gaps
from rpod_analysis.report.plot_data import PlotData
from rpod_schemas.arrays import FloatArray

_AXES = "xyz"
_GRID = {
    "gridcolor": "#c5ccd3",
    "showbackground": False,
    "zeroline": False,
    "showline": True,
    "linecolor": QUIET,
}
_CAMERA = {"eye": {"x": 1.5, "y": 1.5, "z": 1.0}, "center": {"x": 0.0, "y": 0.0, "z": -0.12}}


def path_figure(plot_data: PlotData) -> go.Figure | None:
    """Return a figure of the target's true and estimated path, chaser axes; None if neither is known.

    The two projections need no WebGL, which some browsers do not have.
    """
    paths: list[tuple[str, Samples, dict[str, Any]]] = [
        ("truth", plot_data.true_path, {"color": QUIET, "width": 4}),
        ("estimate", plot_data.path, {"color": ACCENT, "width": 1.4}),
    ]
    known = [(name, _with_gaps(plot_data, path), line) for name, path, line in paths if len(path.rows)]
    if not known:
        return None
    figure = make_subplots(
        rows=2,
        cols=2,
        column_widths=[0.56, 0.44],
        specs=[[{"type": "scene", "rowspan": 2}, {"type": "xy"}], [None, {"type": "xy"}]],
        horizontal_spacing=0.07,
        vertical_spacing=0.16,
    )
    everything = np.concatenate([rows for _, rows, _ in known])
    first, second, third = _by_extent(everything)
    for name, rows, line in known:
        x, y, z = rows.T
        figure.add_trace(
            go.Scatter3d(
                x=x, y=y, z=z, mode="lines", name=name, line=line | {"width": 1.6 * line["width"]},
                hovertemplate="x %{x:.3f}, y %{y:.3f}, z %{z:.3f} m<extra>" + name + "</extra>",
            ),
            row=1, col=1,
        )  # fmt: skip
        for row, across in ((1, second), (2, third)):
            _projection(figure, rows, (first, across), line, row=row, name=name)
    _ends(figure, known[-1][1], (first, second, third))
    _label_axes(figure, _ranges(everything), (first, second, third))
    figure.update_layout(legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0})
    return styled(figure, height=520, top=34, legend=True)


def _with_gaps(plot_data: PlotData, path: Samples) -> FloatArray:
    time_s = plot_data.seconds(path.stamp_ns)
    return np.column_stack([with_gaps(time_s, column)[1] for column in path.rows.T])


def _by_extent(rows: FloatArray) -> tuple[int, int, int]:
    """Return the axes in the order of the path's extent along them, the longest first."""
    first, second, third = np.argsort(np.nanmin(rows, axis=0) - np.nanmax(rows, axis=0), kind="stable")
    return int(first), int(second), int(third)


def _ranges(rows: FloatArray) -> list[list[float]]:
    """Return the limits of each axis; a short extent is not enlarged to look like a long one."""
    low, high = np.nanmin(rows, axis=0), np.nanmax(rows, axis=0)
    half = np.maximum(0.55 * (high - low), 0.1 * (high - low).max())
    half = np.maximum(half, 1e-3)
    middle = (low + high) / 2.0
    return np.column_stack([middle - half, middle + half]).tolist()  # type: ignore[no-any-return]


def _projection(
    figure: go.Figure, rows: FloatArray, axes: tuple[int, int], line: dict[str, Any], *, row: int, name: str
) -> None:
    figure.add_trace(
        go.Scatter(
            x=rows[:, axes[0]], y=rows[:, axes[1]], mode="lines", line=line, showlegend=False,
            hovertemplate="%{x:.3f}, %{y:.3f} m<extra>" + name + "</extra>",
        ),
        row=row, col=2,
    )  # fmt: skip


def _label_axes(figure: go.Figure, ranges: list[list[float]], axes: tuple[int, int, int]) -> None:
    """Name the axes of the scene and of both projections, with the same limits in all of them."""
    scene: dict[str, Any] = {
        f"{axis}axis": {"title": {"text": f"{axis} [m]"}, "range": ranges[index]} | _GRID
        for index, axis in enumerate(_AXES)
    }
    figure.update_scenes(**scene, aspectmode="cube", dragmode="turntable", camera=_CAMERA)
    for row, across in ((1, axes[1]), (2, axes[2])):
        figure.update_xaxes(title_text=f"{_AXES[axes[0]]} [m]", range=ranges[axes[0]], row=row, col=2)
        figure.update_yaxes(title_text=f"{_AXES[across]} [m]", range=ranges[across], row=row, col=2)


def _ends(figure: go.Figure, rows: FloatArray, axes: tuple[int, int, int]) -> None:
    """Mark the beginning and the end of the path."""
    for row, across in ((1, axes[1]), (2, axes[2])):
        figure.add_trace(
            go.Scatter(
                x=rows[[0, -1], axes[0]], y=rows[[0, -1], across], mode="markers+text", text=["begin", "end"],
                marker={"color": ACCENT, "size": 8, "symbol": ["circle-open", "circle"]},
                textposition="top center", showlegend=False, hoverinfo="skip", cliponaxis=False,
            ),
            row=row, col=2,
        )  # fmt: skip
