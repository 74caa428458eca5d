"""A trial of acquisition in a world that differs from the method's assumptions."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.acquiring import SCHEMA, Bench
from rpod_campaign.lidar.methods import Acquiring, lidar_config, lidar_input, pattern_of
from rpod_campaign.lidar.scene import emulator_of
from rpod_schemas.config.emulator import WorldName

__all__ = ["DISTURBANCES", "NOMINAL", "SCHEMA", "RobustnessCell", "run"]


@dataclass(frozen=True)
class Disturbance:
    """Differences between the scanned world and the nominal one."""

    scale: float = 1.0
    """Size of the target over that of its model."""
    detection: Mapping[str, Any] | None = None
    """Fields of the sensor's detection model that differ."""
    noise: Mapping[str, Any] | None = None
    """Fields of the sensor's noise that differ."""


NOMINAL = "nominal"
DISTURBANCES = {
    NOMINAL: Disturbance(),
    "target 1 % larger": Disturbance(scale=1.01),
    "target 1 % smaller": Disturbance(scale=0.99),
    "3 % gross outliers": Disturbance(noise={"gross_outlier_share": 0.03}),
    "sigma doubled": Disturbance(noise={"sigma_range_m": 0.05}),
    "P_D: shot noise, gain squared, F = 3": Disturbance(
        detection={"shot_noise": True, "gain_on_variance": "squared", "excess_noise_factor": 3.0}
    ),
    "P_D: Eq. 4 as printed": Disturbance(detection={"threshold": "printed"}),
}
"""Disturbances by their names in the tables; the method always assumes the nominal world."""


@dataclass(frozen=True)
class RobustnessCell:
    """A method that searches for a target in scans of a disturbed world."""

    target: str
    method: str
    disturbance: str
    step_deg: float | None
    """Step of the template grid, deg; None for other methods."""
    range_m: float
    model: str = ""
    """Name of the target that the method looks for, if it is not the one that is seen."""
    world: WorldName = "documented"
    """Physics of the sensor; the method is not told."""


def run(cell: RobustnessCell, seed: int, trial: int) -> dict[str, Any]:
    """Return the row of one trial; attitudes Euler-uniform, the same in every disturbance."""
    return _bench(cell, seed).acquired(range_m=cell.range_m, sampling="euler", seed=seed, trial=trial)


@lru_cache(maxsize=4)
def _bench(cell: RobustnessCell, seed: int) -> Bench:
    disturbance = DISTURBANCES[cell.disturbance]
    lidar = lidar_config(detection=disturbance.detection, noise=disturbance.noise)
    sensor = lidar_input(cell.method, step_deg=cell.step_deg, centroid="offset", matcher="nearest-neighbour")
    acquiring = Acquiring(sensor, cached_target(cell.model or cell.target), pattern_of(lidar))
    return Bench(
        cell.target,
        emulator_of(cell.target, lidar, seed, world=cell.world, scale=disturbance.scale),
        acquiring,
    )
