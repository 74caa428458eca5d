"""Comparison of several runs: a table of numbers, and their errors over time in common figures."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from rpod_analysis.report.content import ReportContent
from rpod_analysis.report.downsampling import Line
from rpod_analysis.report.figures import BAD, SEVERAL, draw_limit, styled, with_gaps
from rpod_analysis.scoring.score import NEES_95
from rpod_schemas.summary import Summary


@dataclass(frozen=True)
class ComparedRow:
    """One number of every run."""

    title: str
    unit: str
    name: str
    """Path of the value in ``summary.json``, with dots."""
    form: str = ".3g"
    scale: float = 1.0
    better: int = -1
    """-1 if smaller values are better, 1 if larger values are better, 0 if neither."""

    def cells(self, contents: Sequence[ReportContent]) -> list[tuple[str, bool]]:
        """Return the number of each run as text, and whether it is the best among different ones."""
        values = [self._of(content.summary) for content in contents]
        known = [value for value in values if value is not None]
        best = (min if self.better < 0 else max)(known) if self.better and len(set(known)) > 1 else None
        return [
            ("-" if value is None else format(value, self.form), value is not None and value == best)
            for value in values
        ]

    def _of(self, summary: Summary) -> float | None:
        value: Any = summary
        for part in self.name.split("."):
            value = None if value is None else getattr(value, part)
        return None if value is None else self.scale * value


ROWS = (
    ComparedRow("seed", "", "seed", ".0f", better=0),
    ComparedRow("duration", "s", "duration_s", ".1f", better=0),
    ComparedRow("first tracking", "s", "modes.first_tracking_s", ".2f"),
    ComparedRow("time in tracking", "%", "modes.tracked_time_share", ".2f", 1e2, better=1),
    ComparedRow("longest time without a track", "s", "modes.longest_untracked_s", ".2f"),
    ComparedRow("frames in tracking", "%", "modes.tracking_share", ".2f", 1e2, better=1),
    ComparedRow("frames in coasting", "%", "modes.coasting_share", ".2f", 1e2),
    ComparedRow("time lost", "s", "estimates.lost_s", ".2f"),
    ComparedRow("attitude error, rms", "°", "error.attitude_deg.rms"),
    ComparedRow("attitude error, 95 % below", "°", "error.attitude_deg.p95"),
    ComparedRow("attitude error, worst", "°", "error.attitude_deg.max"),
    ComparedRow("position error, rms", "mm", "error.position_m.rms", scale=1e3),
    ComparedRow("position error, 95 % below", "mm", "error.position_m.p95", scale=1e3),
    ComparedRow("position error, worst", "mm", "error.position_m.max", scale=1e3),
    ComparedRow("worse than 10° or 0.3 m", "%", "modes.worse_than_10deg_or_0_3m_share", ".2f", 1e2),
    ComparedRow("NEES, mean (best: its degrees of freedom)", "", "consistency.nees_mean", better=0),
    ComparedRow("degrees of freedom of the NEES", "", "consistency.nees_dof", ".0f", better=0),
    ComparedRow("NEES within the 95 % bound", "%", "consistency.nees_share_in_95", ".1f", 1e2, better=0),
    ComparedRow("handover, gap", "s", "handover.gap_s", ".2f"),
    ComparedRow("handover, jump beyond the covariance", "mm", "handover.jump_m", ".1f", 1e3),
    ComparedRow("handover, jump beyond the covariance", "°", "handover.jump_deg", ".2f"),
    ComparedRow("NIS, mean (best: degrees of freedom of the NEES)", "", "innovation.nis_mean", better=0),
    ComparedRow("latency, median", "ms", "latency_s.p50", scale=1e3),
    ComparedRow("latency, 99 % below", "ms", "latency_s.p99", scale=1e3),
    ComparedRow("processing, median", "ms", "processing_s.p50", scale=1e3),
    ComparedRow("processing, 99 % below", "ms", "processing_s.p99", scale=1e3),
    ComparedRow("frames accepted", "", "estimates.accepted", ".0f", better=0),
    ComparedRow("frames rejected", "", "estimates.rejected", ".0f"),
    ComparedRow("frames dropped", "", "estimates.dropped", ".0f"),
    ComparedRow("messages missed by the log", "", "missed", ".0f"),
)
"""Rows in the order of the table."""


def comparison_figure(contents: Sequence[ReportContent]) -> go.Figure:
    """Return a figure with errors, NEES and distance of all runs over the time from the start of each."""
    figure = make_subplots(
        rows=2,
        cols=2,
        shared_xaxes=True,
        subplot_titles=(
            "attitude error",
            "position error",
            "NEES, dotted its 95 % bound",
            "distance, estimated",
        ),
        vertical_spacing=0.1,
        horizontal_spacing=0.08,
    )
    for content, colour in zip(contents, SEVERAL * (len(contents) // len(SEVERAL) + 1), strict=False):
        plot_data = content.plot_data
        panels = (
            (plot_data.angle_deg, "°"),
            (plot_data.distance_m, "m"),
            (plot_data.nees, ""),
            (plot_data.range_m, "m"),
        )
        for place, (line, unit) in enumerate(panels):
            trace = _line(content, line, unit, colour=colour, legend=place == 0)
            figure.add_trace(trace, row=place // 2 + 1, col=place % 2 + 1)
    for place, title in enumerate(("error [°]", "error [m]", "NEES [-]", "distance [m]")):
        figure.update_yaxes(title_text=title, row=place // 2 + 1, col=place % 2 + 1)
    figure.update_yaxes(type="log", exponentformat="power", dtick=1, row=2, col=1)
    for dof in sorted({content.totals.dof for content in contents}):
        draw_limit(figure, "y", NEES_95[dof], BAD, row=2, col=1)
    figure.update_xaxes(title_text="time from each run's start [s]", row=2)
    figure.update_layout(legend={"orientation": "h", "y": 1.05, "yanchor": "bottom", "x": 0})
    return styled(figure, height=620, top=66, legend=True)


def _line(content: ReportContent, line: Line, unit: str, *, colour: str, legend: bool) -> go.Scatter:
    x, y = with_gaps(content.plot_data.seconds(line.stamp_ns), line.values)
    return go.Scatter(
        x=x,
        y=y,
        mode="lines",
        line={"color": colour, "width": 1.3},
        name=content.name,
        legendgroup=content.name,
        showlegend=legend,
        hovertemplate=f"%{{x:.2f}} s: %{{y:.4g}} {unit}<extra>{content.name}</extra>",
    )
