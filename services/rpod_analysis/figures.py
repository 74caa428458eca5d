"""The report's figures, in plotly. Colours of text, grid and paper come from the page's style sheet."""

from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from rpod_analysis.run import Run
from rpod_analysis.score import NEES_95, BoolArray, IntArray
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Mode

ACCENT = "#2f7df6"
BAD = "#d9534f"
QUIET = "#8b949e"
_BAND = "rgba(139,148,158,0.22)"
_MODES = {
    Mode.TRACKING: ACCENT,
    Mode.VERIFYING: "#9cc3fb",
    Mode.ACQUIRING: "#b8bfc7",
    Mode.LOST: BAD,
}
_MOST_POINTS = 5000
_NEES = "NEES and chi-squared, 6 d.o.f."
_AXES = (
    ("roll", "pitch", "yaw"),
    ("x, right", "y, down", "z, boresight"),
)


def error_figure(run: Run) -> go.Figure:
    """Attitude and position errors over time: size, and each axis with the covariance's 3-sigma band."""
    titles = [title for pair in (("attitude", "position"), *zip(*_AXES, strict=True)) for title in pair]
    figure = make_subplots(
        rows=4,
        cols=2,
        shared_xaxes=True,
        subplot_titles=titles,
        vertical_spacing=0.055,
        horizontal_spacing=0.08,
    )
    order = np.argsort(run.estimates.stamp_ns, kind="stable")
    time_s = run.seconds(run.estimates.stamp_ns)[order]
    sigma_deg, sigma_m = _sigmas(run)
    columns = (
        (np.rad2deg(run.errors.angle_rad), np.rad2deg(run.errors.attitude_rad), sigma_deg, "°", 10.0),
        (run.errors.distance_m, run.errors.position_m, sigma_m, "m", 0.3),
    )
    for column, (size, axes, sigma, unit, limit) in enumerate(columns, start=1):
        _line(figure, time_s, size[order], unit, row=1, col=column)
        if np.nanmax(size, initial=0.0) > 0.6 * limit:
            _limit(figure, "y", limit, BAD, row=1, col=column)
        for axis in range(3):
            _band(figure, time_s, 3.0 * sigma[order, axis], unit, row=axis + 2, col=column)
            _line(figure, time_s, axes[order, axis], unit, row=axis + 2, col=column)
            reach = _reach(axes[:, axis], sigma[:, axis])
            figure.update_yaxes(range=[-reach, reach], row=axis + 2, col=column)
        for row in range(1, 5):
            figure.update_yaxes(title_text=f"error [{unit}]", row=row, col=column)
        figure.update_yaxes(rangemode="tozero", row=1, col=column)
        figure.update_xaxes(title_text="time [s]", row=4, col=column)
    return styled(figure, height=860)


def state_figure(run: Run) -> go.Figure:
    """The navigator's state as bands, rejected frames, and the distance to the target."""
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, row_heights=[0.16, 0.84], vertical_spacing=0.05)
    time_s = run.seconds(run.statuses.stamp_ns)
    _mode_bands(figure, time_s, run.statuses.mode)
    rejected = ~run.statuses.accepted
    figure.add_trace(
        go.Scatter(
            x=time_s[rejected][:_MOST_POINTS],
            y=np.full(min(rejected.sum(), _MOST_POINTS), 0.5),
            mode="markers",
            marker={"symbol": "line-ns-open", "size": 14, "color": "#111"},
            name="rejected",
            showlegend=False,
            text=run.statuses.reason[rejected][:_MOST_POINTS],
            hovertemplate="%{x:.2f} s: %{text}<extra></extra>",
        ),
        row=1,
        col=1,
    )
    for track, name, line in (
        (run.truth, "truth", {"color": QUIET, "width": 4}),
        (run.estimates, "estimate", {"color": ACCENT, "width": 1.6}),
    ):
        order = np.argsort(track.stamp_ns, kind="stable")
        distance_m = np.linalg.norm(track.poses.translation[order], axis=1)
        x, y = _thinned(run.seconds(track.stamp_ns)[order], distance_m)
        figure.add_trace(
            go.Scatter(
                x=x,
                y=y,
                mode="lines",
                name=name,
                line=line,
                hovertemplate="%{x:.2f} s: %{y:.3f} m<extra></extra>",
            ),
            row=2,
            col=1,
        )
    figure.update_yaxes(visible=False, range=[0, 1], fixedrange=True, row=1, col=1)
    figure.update_yaxes(title_text="distance [m]", row=2, col=1)
    figure.update_xaxes(title_text="time [s]", row=2, col=1)
    figure.update_layout(legend={"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0})
    return styled(figure, height=320, top=44, legend=True)


def histogram_figure(run: Run) -> go.Figure:
    """Distributions of latency, processing time, and NEES beside what it should be; of what is known."""
    nees = run.errors.nees[run.tracked]
    panels = [
        ("latency, stamp to estimate", "latency [ms]", 1e3 * run.latency_s),
        ("processing", "processing [ms]", 1e3 * run.statuses.processing_s),
        (_NEES, "NEES [-]", nees),
    ]
    known = [(title, axis, values[np.isfinite(values)]) for title, axis, values in panels]
    known = [panel for panel in known if panel[2].size]
    titles = [title for title, _, _ in known] or [""]
    figure = make_subplots(rows=1, cols=len(titles), subplot_titles=titles, horizontal_spacing=0.07)
    for column, (title, axis, values) in enumerate(known, start=1):
        end = 3.0 * (NEES_95 if title == _NEES else float(np.percentile(values, 90)))
        note = ", larger ones in the last bar" * bool((values > end).any())
        _histogram(figure, values.clip(None, end), axis + note, col=column, density=title == _NEES)
        if title == _NEES:
            _chi_squared(figure, col=column)
    return styled(figure, height=300)


def _chi_squared(figure: go.Figure, *, col: int) -> None:
    x = np.linspace(0.0, 3.0 * NEES_95, 200)
    density = x**2 * np.exp(-x / 2) / 16  # six degrees of freedom; scipy.stats takes half a second to import
    line = {"color": QUIET, "width": 2}
    figure.add_trace(go.Scatter(x=x, y=density, mode="lines", line=line, hoverinfo="skip"), row=1, col=col)
    _limit(figure, "x", NEES_95, QUIET, row=1, col=col)


def _sigmas(run: Run) -> tuple[FloatArray, FloatArray]:
    """Return sigma of attitude in target axes, deg, and of position in the sensor's, m, each (N, 3)."""
    R = run.estimates.poses.rotation.as_matrix()
    attitude = np.einsum("nji,njk,nki->ni", R, run.covariance[:, 3:, 3:], R)
    C = run.R_chaser_sensor.as_matrix()
    position = np.einsum("nji,njk,nki->ni", C, run.covariance[:, :3, :3], C)
    return np.rad2deg(np.sqrt(attitude.clip(0.0))), np.sqrt(position.clip(0.0))


def _reach(error: FloatArray, sigma: FloatArray) -> float:
    """Return how far a panel reaches: all of the errors, and of the band what it mostly is."""
    return max(1.15 * float(np.nanmax(np.abs(error))), 3.5 * float(np.median(sigma)), 1e-9)


def _limit(figure: go.Figure, axis: str, value: float, colour: str, *, row: int, col: int) -> None:
    """Draw a dotted line at a value of an axis, across the whole panel."""
    across = "y" if axis == "x" else "x"
    ends = {f"{axis}0": value, f"{axis}1": value, f"{across}0": 0, f"{across}1": 1}
    line = {"color": colour, "width": 1, "dash": "dot"}
    reference = {f"{across}ref": f"{across} domain"}
    figure.add_shape(**ends, **reference, type="line", line=line, row=row, col=col)


def _line(
    figure: go.Figure, time_s: FloatArray, values: FloatArray, unit: str, *, row: int, col: int
) -> None:
    x, y = _thinned(*_with_gaps(time_s, values))
    figure.add_trace(
        go.Scatter(
            x=x,
            y=y,
            mode="lines" if x.size > 100 else "lines+markers",
            line={"color": ACCENT, "width": 1.4},
            marker={"size": 5},
            hovertemplate=f"%{{x:.2f}} s: %{{y:.4g}} {unit}<extra></extra>",
        ),
        row=row,
        col=col,
    )


def _band(figure: go.Figure, time_s: FloatArray, half: FloatArray, unit: str, *, row: int, col: int) -> None:
    if not (half > 0.0).any():
        return
    step = len(time_s) // (_MOST_POINTS // 2) + 1
    x, y = time_s[::step], half[::step]
    figure.add_trace(
        go.Scatter(
            x=np.concatenate([x, x[::-1]]),
            y=np.concatenate([y, -y[::-1]]),
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


def _with_gaps(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Break the line where the estimates pause, so that nothing is drawn where nothing was known."""
    if time_s.size < 3:
        return time_s, values
    step_s = np.diff(time_s)
    pauses = np.flatnonzero(step_s > max(5.0 * float(np.median(step_s)), 0.3)) + 1
    return np.insert(time_s, pauses, time_s[pauses]), np.insert(values, pauses, np.nan)


def _thinned(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return at most 5,000 points; of every stretch its lowest and highest, so that no peak is lost."""
    if x.size <= _MOST_POINTS:
        return x, y
    stretches = np.array_split(np.arange(x.size), _MOST_POINTS // 2)
    low = [part[np.argmin(np.nan_to_num(y[part], nan=np.inf))] for part in stretches]
    high = [part[np.argmax(np.nan_to_num(y[part], nan=-np.inf))] for part in stretches]
    keep = np.unique(low + high)
    return x[keep], y[keep]


def _mode_bands(figure: go.Figure, time_s: FloatArray, mode: IntArray) -> None:
    """One bar a stretch of equal mode; bars of one mode are one trace."""
    if not mode.size:
        return
    starts = np.flatnonzero(np.diff(mode, prepend=-1))
    ends = np.append(time_s[starts[1:]], time_s[-1])
    for value, colour in _MODES.items():
        mine: BoolArray = mode[starts] == value
        if mine.any():
            figure.add_trace(
                go.Bar(
                    orientation="h",
                    base=time_s[starts][mine],
                    x=(ends - time_s[starts])[mine],
                    y=np.full(mine.sum(), 0.5),
                    width=0.9,
                    marker={"color": colour, "line": {"width": 0}},
                    name=value.name,
                    hovertemplate=f"{value.name}<br>%{{base:.2f}} s for %{{x:.2f}} s<extra></extra>",
                ),
                row=1,
                col=1,
            )
    figure.update_layout(barmode="overlay")


def _histogram(figure: go.Figure, values: FloatArray, title: str, *, col: int, density: bool) -> None:
    figure.update_xaxes(title_text=title, row=1, col=col)
    figure.update_yaxes(title_text="density" if density else "frames", rangemode="tozero", row=1, col=col)
    counts, edges = np.histogram(values, bins=min(40, max(8, int(np.sqrt(values.size)) * 2)), density=density)
    figure.add_trace(
        go.Bar(
            x=(edges[1:] + edges[:-1]) / 2.0,
            y=counts,
            width=np.diff(edges),
            marker={"color": ACCENT, "line": {"width": 0}},
            hovertemplate="%{x:.1f}: %{y:.3g}<extra></extra>",
        ),
        row=1,
        col=col,
    )


def styled(figure: go.Figure, *, height: int, top: int = 28, legend: bool = False) -> go.Figure:
    """Give a figure the reports' looks, and return it."""
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
        hoverlabel={"font": {"family": "system-ui, sans-serif"}},
    )
