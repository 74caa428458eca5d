"""Summary of a sequence of images."""

from collections.abc import Sequence
from typing import Any

import polars as pl

from rpod_campaign.engine.campaign import TRIAL, CellResult
from rpod_campaign.engine.report.statistics import consistency, mean, quantile, root_mean_square
from rpod_campaign.pmd.sequence import SequenceCell

Results = Sequence[CellResult[SequenceCell]]
AXES = ("roll_deg", "pitch_deg", "yaw_deg", "x_m", "y_m", "z_m")
"""Columns of the errors: attitude in target axes, position in the sensor's (ICD section 1)."""
OTHER_AXES = (
    "sensor_roll_deg", "sensor_pitch_deg", "sensor_yaw_deg", "target_x_m", "target_y_m", "target_z_m",
)  # fmt: skip
"""Columns of the same errors in the other axes: attitude in the sensor's, position in the target's."""


def summarise(cell: SequenceCell, rows: pl.DataFrame) -> dict[str, Any]:
    """Return the summary of a sequence; RMS errors include frames that kept the last pose.

    ``success_rate``, ``wrong_accepted`` and ``ambiguous`` are over frames. Right is within the limits of an
    acquisition.
    """
    return {
        "scenario": cell.scenario,
        "method": cell.method,
        "radius_px": cell.radius_px,
        "frames": rows.height,
        "rms": rms(rows),
        "norms": {
            "attitude_deg": root_mean_square(rows["attitude_deg"]),
            "position_m": root_mean_square(rows["position_m"]),
        },
        "max": {name: quantile(rows[name], 1.0) for name in ("attitude_deg", "position_m")},
        "median_s": quantile(rows["track_s"], 0.5),
        "p95_s": quantile(rows["track_s"], 0.95),
        "lost": int((rows["off_target"] | ~rows["measured"]).sum()),
        "lost_without_pose": int((~rows["measured"]).sum()),
        "lost_off_target": int(rows["off_target"].sum()),
        **consistency(rows),
        "depth_share": mean(rows["depth_share"]),
        "trials": rows[TRIAL].n_unique(),
        "success_rate": mean(rows["right"].cast(pl.Float64)),
        "wrong_accepted": int((rows["believed"] & ~rows["right"]).sum()),
        "ambiguous": int(rows["ambiguous"].sum()),
        "sequence": cell.frames,
        "through": cell.through,
        "case": cell.case,
    }


def rms(rows: pl.DataFrame, axes: tuple[str, ...] = AXES) -> dict[str, float | None]:
    """Return the RMS errors along axes; None without rows."""
    names = (name.removeprefix("sensor_").removeprefix("target_") for name in axes)
    return {name: root_mean_square(rows[axis]) for name, axis in zip(names, axes, strict=True)}
