"""The summary of a run on a terminal."""

from rich.console import Console
from rich.table import Table

from rpod_analysis.scoring.run_checks import MAX_DROPPED_SHARE, dropped_share
from rpod_schemas.summary import ErrorSummary, Handover, Summary

_MANY = 0.1
"""Ratio of a sensor's unused frames to its used ones above which the reason is printed."""


def print_summary(summary: Summary, console: Console, *, name: str = "") -> None:
    """Print the summary that an operator needs first: tracking, errors, lost data.

    Args:
        summary: summary of the run.
        console: where it is printed.
        name: name of the run among others; by default its scenario.
    """
    title = f"{name or summary.scenario or summary.log}, {summary.duration_s:.0f} s"
    table = Table(title=title, title_justify="left", show_header=False)
    table.add_column(style="dim")
    for row in _rows(summary):
        table.add_row(*row)
    console.print(table)


def _rows(summary: Summary) -> list[tuple[str, str]]:
    estimates, modes = summary.estimates, summary.modes
    return [
        *_target_rows(summary),
        (
            "tracking",
            f"{_percent(modes.tracked_time_share)} of the time, longest without a track "
            f"{_seconds(modes.longest_untracked_s)}; first at {_seconds(modes.first_tracking_s)}, then "
            f"{_percent(modes.tracking_share)} of the frames"
            + f", {_percent(modes.coasting_share)} coasting"
            * bool(modes.coasting_share),
        ),
        *_error_rows(summary.error),
        *(
            (
                f"at {name}",
                f"{error.attitude_deg.rms:.2f} deg RMS, {1e3 * error.position_m.rms:.0f} mm RMS, "
                f"{1e3 * error.position_m.max:.0f} max",
            )
            for name, error in summary.frame_errors.items()
        ),
        *(
            (f"joint {name}", f"{error.rms:.2f} deg RMS, {error.max:.2f} max")
            for name, error in summary.joint_errors.items()
        ),
        ("worse than 10 deg or 0.3 m", _percent(modes.worse_than_10deg_or_0_3m_share)),
        (
            "frames",
            f"{estimates.accepted} accepted, {estimates.rejected} rejected, {estimates.dropped} dropped, "
            f"{estimates.unscored} unscored",
        ),
        *_pace_rows(summary),
        *_unused_rows(summary),
        *_measured_rows(summary),
        *((f"mounts of {pair}", found.text) for pair, found in summary.mounts.items()),
        _message_row(summary),
    ]


def _pace_rows(summary: Summary) -> list[tuple[str, str]]:
    """Return a row with the remedy if so many frames were dropped that the run does not pass its check."""
    share = dropped_share(summary)
    if share <= MAX_DROPPED_SHARE:
        return []
    text = f"{_percent(share)} of the frames: this machine is busy or slow; a run with --speed max drops none"
    return [("dropped", text)]


def _unused_rows(summary: Summary) -> list[tuple[str, str]]:
    """Return a row for each sensor of which more than a tenth of the frames was not used, with a reason."""
    rows = []
    for sensor, frames in summary.inputs.items():
        for how, unused in frames.not_used.items():
            if unused.frames > _MANY * frames.used:
                title = f"{sensor}, {how.replace('_', ' ')}"
                rows.append((title, f"{unused.frames} frames; the last one: {unused.last}"))
    return rows


def _measured_rows(summary: Summary) -> list[tuple[str, str]]:
    """Return the rows of what is known of some runs only: times, consistency, handovers, integrity."""
    rows = []
    if summary.latency_s:
        rows.append(
            (
                "latency",
                f"{1e3 * summary.latency_s.p50:.0f} ms median, {1e3 * summary.latency_s.p99:.0f} ms p99",
            )
        )
    if summary.processing_s:
        times = summary.processing_s
        rows.append(("processing", f"{1e3 * times.p50:.1f} ms median, {1e3 * times.p99:.1f} ms p99"))
    if summary.consistency:
        nees = summary.consistency
        within = f"{_percent(nees.nees_share_in_95)} within the 95 % bound"
        rows.append(("NEES", f"mean {nees.nees_mean:.1f}, expected {nees.nees_dof}; {within}"))
    if summary.handover:
        rows.append(("handover", _handover(summary.handover)))
    if summary.integrity:
        told = summary.integrity
        misleading = "-" if told.misleading is None else str(told.misleading)
        alerts = f"{told.alerts} alert{'s' * (told.alerts != 1)}"
        within = f"available {_percent(told.availability)}"
        rows.append(("integrity", f"{misleading} misleading, {alerts}, {within}"))
    return rows


def _message_row(summary: Summary) -> tuple[str, str]:
    missed = sum(frame.missed for frame in summary.frames.values())
    published = sum(frame.published for frame in summary.frames.values())
    unreadable = sum(sum(reasons.values()) for reasons in summary.unreadable.values())
    told = f", {unreadable} cannot be read (the report says why)" * bool(unreadable)
    completeness = summary.completeness
    if completeness is not None and completeness.complete is False:
        reason, *others = completeness.reasons or ("the report says why",)
        more = f" and {len(others)} more (the report lists them)" * bool(others)
        told += f"; the log is not complete: {reason}{more}"
    return "messages", f"{published} published, {missed} missed by the log{told}"


def _handover(handover: Handover) -> str:
    change = ""
    if handover.change_m is not None and handover.change_deg is not None:
        change = f"; change {1e3 * handover.change_m:.1f} mm, {handover.change_deg:.2f} deg"
    jump = "jump unknown"
    if handover.jump_m is not None and handover.jump_deg is not None:
        jump = f"jump beyond the covariance {1e3 * handover.jump_m:.1f} mm, {handover.jump_deg:.2f} deg"
    return f"{handover.count} between sensors, gap {handover.gap_s:.2f} s{change}; {jump}"


def _target_rows(summary: Summary) -> list[tuple[str, str]]:
    """Return the row that names the targets of truth and model; none if they are the same."""
    model = summary.differing_model
    return [] if model is None else [("target", f"truth {summary.target}, model {model}")]


def _error_rows(error: ErrorSummary | None) -> list[tuple[str, str]]:
    if error is None:
        return [("error", "unknown: no frame was tracked while the truth was known")]
    attitude, position = error.attitude_deg, error.position_m
    return [
        ("attitude", f"{attitude.rms:.2f} deg RMS, {attitude.p95:.2f} p95, {attitude.max:.2f} max"),
        (
            "roll, pitch, yaw",
            f"{error.roll_deg_rms:.2f}, {error.pitch_deg_rms:.2f}, {error.yaw_deg_rms:.2f} deg RMS",
        ),
        (
            "position",
            f"{1e3 * position.rms:.0f} mm RMS, {1e3 * position.p95:.0f} p95, {1e3 * position.max:.0f} max",
        ),
        (
            "x, y, z",
            f"{1e3 * error.x_m_rms:.0f}, {1e3 * error.y_m_rms:.0f}, {1e3 * error.z_m_rms:.0f} mm RMS",
        ),
    ]


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f} %"


def _seconds(time_s: float | None) -> str:
    return "-" if time_s is None else f"{time_s:.1f} s"
