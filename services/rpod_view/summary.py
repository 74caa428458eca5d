"""A short table of the navigator's state for the operator."""

from collections.abc import Iterable

import numpy as np

from rpod_schemas.types import Diagnostic, EstimatorStatus, Integrity, IntegrityState, Source
from rpod_view.scene import Scored
from rpod_view.shading import MILLIMETRES, band

_SILENT_S = 2.0
"""Time without a status after which the table says so, s."""
SOURCES = {
    Source.NONE: "none",
    Source.LIDAR: "LIDAR",
    Source.PMD_DEPTH: "PMD depth",
    Source.PMD_AMPLITUDE: "PMD amplitude",
    Source.PMD_JOINT: "PMD depth and amplitude",
    Source.OTHER: "other sensor",
}
"""Names of the pose's sources."""


def summary(
    status: EstimatorStatus | None,
    scored: Scored | None,
    troubles: Iterable[Diagnostic],
    integrity: Integrity | None = None,
    silent_s: float = 0.0,
) -> str:
    """Return Markdown of the last status, estimate and integrity, and what services warn of.

    Args:
        status: the last status; None if there is none.
        scored: the last estimate.
        troubles: diagnostics whose level is not OK.
        integrity: the last integrity.
        silent_s: time since the last status, s.
    """
    told = "".join(f"\n\n**{each.level.name}** {each.name}: {each.message}" for each in troubles)
    if status is None:
        return f"# no estimator\n\nWaiting for the estimator's first status.{told}"
    rows = [
        ("source", SOURCES[status.source]),
        ("measurement", _measurement(status)),
        ("processing", _value(1e3 * status.processing_s, "ms")),
    ]
    if status.mode.has_track and scored is not None:
        rows += _rows_of(scored)
    if integrity is not None:
        rows += _rows_of_integrity(integrity)
    table = "\n".join(f"| {name} | {value} |" for name, value in rows)
    silence = f"\n\n**no status for {int(silent_s)} s**" if silent_s > _SILENT_S else ""
    return f"# {status.mode.name}{silence}\n\n| | |\n|---|---|\n{table}{told}"


def _measurement(status: EstimatorStatus) -> str:
    if not status.sensor:
        return "-"
    return "accepted" if status.accepted else f"rejected: {_cell(status.reason) or '-'}"


def _cell(text: str) -> str:
    """Return a text without the character that ends a cell of the table."""
    return text.replace("|", "/")


def _rows_of(scored: Scored) -> list[tuple[str, str]]:
    estimate = scored.estimate
    rows = [
        ("range", _value(float(np.linalg.norm(estimate.pose.translation)), "m")),
        ("turn rate", _value(float(np.rad2deg(np.linalg.norm(estimate.angular_rad_s))), "deg/s")),
    ]
    position_mm = MILLIMETRES * band(estimate.pose_covariance[:3, :3])
    attitude_deg = float(np.rad2deg(band(estimate.pose_covariance[3:, 3:])))
    if scored.position_m is None or scored.attitude_rad is None:
        return [*rows, ("3 sigma", f"{position_mm:.1f} mm, {attitude_deg:.2f} deg")]
    error_mm = MILLIMETRES * float(np.linalg.norm(scored.position_m))
    error_deg = float(np.rad2deg(np.linalg.norm(scored.attitude_rad)))
    return [
        *rows,
        ("position error", f"{error_mm:.1f} mm (3 sigma {position_mm:.1f})"),
        ("attitude error", f"{error_deg:.2f} deg (3 sigma {attitude_deg:.2f})"),
    ]


def _rows_of_integrity(told: Integrity) -> list[tuple[str, str]]:
    reason = _cell(told.reason) * (told.state != IntegrityState.NOMINAL)
    position_mm, limit_mm = (MILLIMETRES * each for each in (told.position_level_m, told.position_limit_m))
    return [
        ("integrity", f"**{told.state.name}** {reason}".strip()),
        ("position level", f"{_value(position_mm, 'mm')}, limit {_value(limit_mm, 'mm')}"),
        (
            "attitude level",
            f"{_value(told.attitude_level_deg, 'deg')}, limit {_value(told.attitude_limit_deg, 'deg')}",
        ),
    ]


def _value(value: float, unit: str) -> str:
    return f"{value:.2f} {unit}" if np.isfinite(value) else "-"
