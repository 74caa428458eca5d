"""One acquisition in one scan, as a row."""

from typing import Any

import polars as pl

from rpod_campaign.engine.trial.poses import POSE, errors, numbers
from rpod_campaign.lidar.methods import Acquiring
from rpod_campaign.lidar.scene import Drawn, scan_of
from rpod_campaign.lidar.scores import ACQUISITION_SCHEMA, acquisition_row
from rpod_sim_sensor.lidar import LidarEmulator

SCHEMA: dict[str, Any] = {
    **ACQUISITION_SCHEMA,
    "template": POSE,
    "template_attitude_error_deg": pl.Float64,
    "template_position_error_m": pl.Float64,
    "acquire_s": pl.Float64,
    "icp_s": pl.Float64,
    "discarded": pl.Int64,
}


def acquired(acquiring: Acquiring, emulator: LidarEmulator, drawn: Drawn, *, trial: int) -> dict[str, Any]:
    """Return the row of a method for the scan of one pose."""
    scan = scan_of(emulator, drawn.T_sensor_target, trial=trial)
    timed = acquiring.acquire(scan)
    truth, target = drawn.T_sensor_target, acquiring.target
    attitude_deg, position_m = errors(truth, timed.template, target)
    return {
        **acquisition_row(truth, timed.acquisition, len(scan.returns_m), target),
        "template": numbers(timed.template),
        "template_attitude_error_deg": attitude_deg,
        "template_position_error_m": position_m,
        "acquire_s": timed.acquire_s,
        "icp_s": timed.icp_s,
        "discarded": drawn.discarded,
    }
