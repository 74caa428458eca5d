"""A trial of the acceptance: is a right pose accepted, and a wrong one rejected?

Wrong poses come from methods that fail on their own target, and from scans of another object, for which no
pose is right. The facility's own check decides on all of them, whatever method found them.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import polars as pl

from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.methods import MATCHERS, lidar_config, lidar_input, pattern_of
from rpod_campaign.lidar.scene import emulator_of, random_pose, scan_of
from rpod_campaign.lidar.scores import ACQUISITION_SCHEMA, acquisition_row, limits_of
from rpod_pose.lidar.global_search import GlobalSearch
from rpod_pose.lidar.paper_2015.icp_nearest_neighbour import NearestNeighbourIcp
from rpod_pose.lidar.projective_icp import ProjectiveIcp
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.methods import methods_of
from rpod_pose.ports import Acquisition
from rpod_schemas.config.emulator import WorldName
from rpod_schemas.config.lidar.methods import IcpNearestNeighbourConfig
from rpod_schemas.config.lidar.search import GlobalSearchConfig
from rpod_schemas.types import LidarScan
from rpod_sim_sensor.lidar import LidarEmulator

REFERENCE = "envisat-bulky"
"""Target for whose size ranges are given; others are scanned from ranges in proportion to their size."""

SCHEMA: dict[str, Any] = {
    **ACQUISITION_SCHEMA,
    "wrong": pl.Boolean,
    "scanned_range_m": pl.Float64,
    "deficit_per_return": pl.Float64,
}
"""Columns of a row; f_conv_m2 is that of the 2015 paper, by its ICP from the checked pose."""


@dataclass(frozen=True)
class AcceptanceCell:
    """A method that searches for a target, and the object that is scanned."""

    target: str
    """Name of the target that is searched."""
    scanned_target: str
    """Name of the target that is scanned."""
    method: str
    step_deg: float | None
    """Step of the template grid, deg; None for other methods."""
    range_m: float
    """Range for the reference, m; scaled by the size of the scanned object."""
    world: WorldName = "documented"
    """Physics of the sensor; the method is not told."""


def run(cell: AcceptanceCell, seed: int, trial: int) -> dict[str, Any]:
    """Return the row of one trial; attitudes uniform on SO(3)."""
    emulator, method = _bench(cell, seed)
    range_m = cell.range_m * size_m(cell.scanned_target) / size_m(REFERENCE)
    drawn = random_pose(cell.scanned_target, range_m=range_m, sampling="so3", seed=seed, trial=trial)
    scan = scan_of(emulator, drawn.T_sensor_target, trial=trial)
    acquisition = method.checked(scan)
    row = acquisition_row(drawn.T_sensor_target, acquisition, len(scan.returns_m), cached_target(cell.target))
    other = cell.scanned_target != cell.target
    wrong = other or not limits_of(cached_target(cell.target)).are_met(
        row["attitude_error_deg"], row["position_error_m"]
    )
    return {**row, **method.scores(scan, acquisition), "wrong": wrong, "scanned_range_m": range_m}


class CheckedMethod:
    """A method, the facility's own check of its poses, and single scores of these poses."""

    def __init__(self, cell: AcceptanceCell, pattern: ScanPattern) -> None:
        target = cached_target(cell.target)
        sensor = lidar_input(
            cell.method, step_deg=cell.step_deg, centroid="offset", matcher="nearest-neighbour"
        )
        config = GlobalSearchConfig()
        self._acquirer = methods_of(sensor, target, pattern).acquirer
        self._searches_by_itself = sensor.acquisition == config
        self._check = GlobalSearch(config, target, pattern)
        self._fine = ProjectiveIcp(config.tracking, target, pattern)
        paper = IcpNearestNeighbourConfig.model_validate(MATCHERS["nearest-neighbour"])
        self._paper = NearestNeighbourIcp(paper, target, pattern)

    def checked(self, scan: LidarScan) -> Acquisition:
        """Return the method's acquisition, with the result of the facility's check."""
        found = self._acquirer.acquire(scan)
        if self._searches_by_itself or found.pose is None:
            return found
        return self._check.verify(scan, found.pose)

    def scores(self, scan: LidarScan, checked: Acquisition) -> dict[str, float | None]:
        """Return f_CONV, m2, and the deficit for each return at the checked pose; None without one."""
        pose = checked.pose
        if pose is None:
            return {"f_conv_m2": None, "deficit_per_return": None}
        seen = self._fine.view.seen(scan)
        fit = self._fine.model.fit(seen, pose.rotation.as_matrix(), pose.translation)
        return {
            "f_conv_m2": self._paper.track(scan, pose).cost_m2,
            "deficit_per_return": fit.deficit / seen.returns,
        }


@lru_cache(maxsize=8)
def size_m(target: str) -> float:
    """Return the square root of a target's surface area, m."""
    a, b, c = np.moveaxis(cached_target(target).triangles_m, 1, 0)
    areas_m2 = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0
    return float(np.sqrt(areas_m2.sum()))


@lru_cache(maxsize=4)
def _bench(cell: AcceptanceCell, seed: int) -> tuple[LidarEmulator, CheckedMethod]:
    lidar = lidar_config()
    return emulator_of(cell.scanned_target, lidar, seed, world=cell.world), CheckedMethod(
        cell, pattern_of(lidar)
    )
