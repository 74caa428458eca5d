"""A trial of acquisition at a range and a scan step, the detection model on or off."""

from dataclasses import dataclass
from functools import lru_cache
from math import asin, ceil, degrees
from typing import Any

from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.acquiring import SCHEMA, Bench
from rpod_campaign.lidar.methods import Acquiring, lidar_config, lidar_input, pattern_of
from rpod_campaign.lidar.scene import emulator_of
from rpod_schemas.config.emulator import WorldName
from rpod_schemas.config.lidar import LidarConfig

__all__ = ["SCHEMA", "RangeCell", "lidar_of", "run", "window_deg"]

_WIDEST_DEG, _WHOLE_DEG = 40.0, 2.0


@dataclass(frozen=True)
class RangeCell:
    """A method that searches for a target in scans with one step."""

    target: str
    method: str
    detection: str
    """Detection model. on: that of the 2015 paper; off: every ray that meets the target returns."""
    scan_step_deg: float
    step_deg: float | None
    """Step of the template grid, deg; None for other methods."""
    range_m: float
    model: str = ""
    """Name of the target that the method looks for, if it is not the one that is seen."""
    world: WorldName = "documented"
    """Physics of the sensor; the method is not told."""


def window_deg(target: str, range_m: float) -> float:
    """Return the scan window of both axes, deg: the target's bounding sphere in whole 2 deg, 40 at most."""
    radius_m = cached_target(target).radius_m
    if radius_m >= range_m:
        return _WIDEST_DEG
    sphere_deg = 2.0 * degrees(asin(radius_m / range_m))
    return min(_WIDEST_DEG, _WHOLE_DEG * ceil(sphere_deg / _WHOLE_DEG))


@lru_cache(maxsize=32)
def lidar_of(cell: RangeCell) -> LidarConfig:
    """Return the sensor of a cell."""
    returned = "all" if cell.detection == "off" else "detected"
    return lidar_config(
        step_deg=cell.scan_step_deg,
        span_deg=window_deg(cell.target, cell.range_m),
        detection={"returned": returned},
    )


def run(cell: RangeCell, seed: int, trial: int) -> dict[str, Any]:
    """Return the row of one trial; attitudes Euler-uniform."""
    return _bench(cell, seed).acquired(range_m=cell.range_m, sampling="euler", seed=seed, trial=trial)


@lru_cache(maxsize=2)
def _bench(cell: RangeCell, seed: int) -> Bench:
    lidar = lidar_of(cell)
    sensor = lidar_input(
        cell.method,
        step_deg=cell.step_deg,
        centroid="offset",
        matcher="nearest-neighbour",
    )
    acquiring = Acquiring(sensor, cached_target(cell.model or cell.target), pattern_of(lidar))
    return Bench(cell.target, emulator_of(cell.target, lidar, seed, world=cell.world), acquiring)
