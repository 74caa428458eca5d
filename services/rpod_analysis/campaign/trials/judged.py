"""A trial of the verdict: is a right pose accepted, and a wrong one refused?

Wrong poses come from methods that go wrong on their own target, and from scans of something else, where no
pose is right.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import polars as pl

from rpod_analysis.campaign.trials import acquisition
from rpod_analysis.campaign.trials.acquisition import acquired
from rpod_analysis.campaign.trials.methods import Acquiring, lidar_config, lidar_input, pattern_of
from rpod_analysis.campaign.trials.scene import cached_target, emulator_of, random_pose
from rpod_analysis.campaign.trials.scores import is_wrong
from rpod_sim_sensor.lidar import LidarEmulator

REFERENCE = "envisat-bulky"
"""Ranges are given for a target of this size; others are scanned from nearer or farther by their size."""

SCHEMA: dict[str, Any] = {**acquisition.SCHEMA, "wrong": pl.Boolean, "scanned_range_m": pl.Float64}


@dataclass(frozen=True)
class JudgedCell:
    """A method that looks for a target, and what is really there."""

    target: str
    """The model."""
    scanned_target: str
    """What is scanned."""
    method: str
    step_deg: float | None
    """Of the template grid; None of other methods."""
    range_m: float
    """For the reference; scaled by the size of what is scanned."""


def run(cell: JudgedCell, seed: int, trial: int) -> dict[str, Any]:
    """Return the row of one trial; attitudes uniform on SO(3)."""
    emulator, acquiring = _bench(cell, seed)
    range_m = cell.range_m * size_m(cell.scanned_target) / size_m(REFERENCE)
    drawn = random_pose(cell.scanned_target, range_m=range_m, sampling="so3", seed=seed, trial=trial)
    row = acquired(acquiring, emulator, drawn, trial=trial)
    other = cell.scanned_target != cell.target
    wrong = other or is_wrong(row["attitude_error_deg"], row["position_error_m"])
    return {**row, "wrong": wrong, "scanned_range_m": range_m}


@lru_cache(maxsize=8)
def size_m(target: str) -> float:
    """Return the square root of a target's surface area."""
    a, b, c = np.moveaxis(cached_target(target).triangles_m, 1, 0)
    areas_m2 = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0
    return float(np.sqrt(areas_m2.sum()))


@lru_cache(maxsize=4)
def _bench(cell: JudgedCell, seed: int) -> tuple[LidarEmulator, Acquiring]:
    lidar = lidar_config()
    sensor = lidar_input(cell.method, step_deg=cell.step_deg, centroid="offset", matcher="nearest-neighbour")
    acquiring = Acquiring(sensor, cached_target(cell.target), pattern_of(lidar))
    return emulator_of(cell.scanned_target, lidar, seed), acquiring
