"""One acquisition in one scan, as a row."""

from typing import Any, NamedTuple

import polars as pl

from rpod_campaign.engine.trial.poses import POSE, errors, numbers
from rpod_campaign.lidar.methods import Acquiring
from rpod_campaign.lidar.scene import random_pose, scan_of
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


class Bench(NamedTuple):
    """A LIDAR before a target, and a method that searches in its scans."""

    target: str
    """Name of the target that is seen."""
    emulator: LidarEmulator
    acquiring: Acquiring

    def acquired(self, *, range_m: float, sampling: str, seed: int, trial: int) -> dict[str, Any]:
        """Return the row of the method for the scan of a random pose; ``sampling`` as in ``random_pose``."""
        drawn = random_pose(self.target, range_m=range_m, sampling=sampling, seed=seed, trial=trial)
        scan = scan_of(self.emulator, drawn.T_sensor_target, trial=trial)
        timed = self.acquiring.acquire(scan)
        truth, model = drawn.T_sensor_target, self.acquiring.target
        attitude_deg, position_m = errors(truth, timed.template, model)
        return {
            **acquisition_row(truth, timed.acquisition, len(scan.returns_m), model),
            "template": numbers(timed.template),
            "template_attitude_error_deg": attitude_deg,
            "template_position_error_m": position_m,
            "acquire_s": timed.acquire_s,
            "icp_s": timed.icp_s,
            "discarded": drawn.discarded,
        }
