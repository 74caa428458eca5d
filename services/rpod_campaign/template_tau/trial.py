"""A trial of ``template-tau``: the fast variant on one scan for several values of tau.

All templates are correlated once. For each tau, the templates that the fast variant would leave out are left
out (2015 paper, section 2.2, Eq. 3), and the best of the others is refined by the paper's ICP.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import polars as pl
from scipy.spatial.transform import Rotation

from rpod_campaign.engine.trial.poses import errors
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.methods import lidar_config, lidar_input, pattern_of
from rpod_campaign.lidar.scene import emulator_of, random_pose, scan_of
from rpod_campaign.lidar.scores import is_success
from rpod_pose.lidar.paper_2015.tau_sweep import sweep_tau
from rpod_pose.lidar.paper_2015.template_matching import OnlineTemplateMatching, euler_grid
from rpod_pose.methods import methods_of
from rpod_pose.ports import Tracker
from rpod_schemas.config.emulator import WorldName
from rpod_schemas.config.lidar.methods import TemplateMatchingConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import LidarScan
from rpod_sim_sensor.lidar import LidarEmulator

TAU = "tau"
"""Column that distinguishes the rows of one scan."""


@dataclass(frozen=True)
class TauCell:
    """A target that is scanned, and the values of tau that are compared."""

    target: str
    step_deg: float
    """Step of the template grid, deg."""
    range_m: float
    taus: tuple[float, ...]
    """Compared values of tau, ascending."""
    world: WorldName = "documented"
    """Physics of the sensor; the method is not told."""


SCHEMA: dict[str, Any] = {
    TAU: pl.Float64,
    "success": pl.Boolean,
    "excluded_share": pl.Float64,
    "plain_success": pl.Boolean,
    "returns": pl.Int64,
}


def run(cell: TauCell, seed: int, trial: int) -> list[dict[str, Any]]:
    """Return a row for each tau; attitudes have uniform Euler angles."""
    emulator, matching, tracker, attitudes = _bench(cell, seed)
    target = cached_target(cell.target)
    drawn = random_pose(cell.target, range_m=cell.range_m, sampling="euler", seed=seed, trial=trial)
    scan = scan_of(emulator, drawn.T_sensor_target, trial=trial)
    points_m = scan.returns_m.astype(np.float64)

    def succeeds(_: int, template: int) -> bool:
        start = make_pose(rotation=attitudes[template], translation_m=points_m.mean(axis=0))
        found = tracker.track(scan, start).T_sensor_target
        return is_success(*errors(drawn.T_sensor_target, found, target), target)

    swept = sweep_tau([matching.compare(points_m)], succeeds, np.array(cell.taus))
    return [
        {
            TAU: tau,
            "success": bool(swept.success_share[index]),
            "excluded_share": float(swept.excluded_share[index]),
            "plain_success": bool(swept.plain_success_share),
            "returns": len(points_m),
        }
        for index, tau in enumerate(cell.taus)
    ]


@lru_cache(maxsize=4)
def _bench(
    cell: TauCell, seed: int
) -> tuple[LidarEmulator, OnlineTemplateMatching, Tracker[LidarScan], Rotation]:
    lidar, target = lidar_config(), cached_target(cell.target)
    pattern = pattern_of(lidar)
    matching = OnlineTemplateMatching(
        TemplateMatchingConfig(step_deg=cell.step_deg, variant="plain"), target, pattern
    )
    sensor = lidar_input(
        "template-matching", step_deg=cell.step_deg, centroid="plain", matcher="nearest-neighbour"
    )
    tracker = methods_of(sensor, target, pattern).tracker
    return (
        emulator_of(cell.target, lidar, seed, world=cell.world),
        matching,
        tracker,
        euler_grid(cell.step_deg),
    )
