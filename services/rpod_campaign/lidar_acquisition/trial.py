"""A trial of acquisition: one scan of the target at a random attitude (2015 paper, section 4.3)."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from rpod_campaign.engine.trial.surroundings import SurroundingsName, surroundings
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.acquiring import SCHEMA, Bench
from rpod_campaign.lidar.methods import Acquiring, lidar_config, lidar_input, pattern_of
from rpod_campaign.lidar.scene import emulator_of
from rpod_schemas.config.emulator import WorldName

__all__ = ["SCHEMA", "AcquisitionCell", "run"]


@dataclass(frozen=True)
class AcquisitionCell:
    """A target that is scanned, and the method that searches for it."""

    target: str
    method: str
    eq4: str
    """Reading of Eq. 4: usual or printed."""
    sampling: str
    """Distribution of the attitudes: euler or so3."""
    centroid: str | None
    """Position of template matching: plain or offset; None for other methods."""
    matcher: str | None
    """ICP after template matching; None for other methods."""
    range_m: float
    step_deg: float | None
    """Step of the template grid, deg; None for other methods."""
    model: str = ""
    """Name of the target that the method looks for, if it is not the one that is seen."""
    world: WorldName = "documented"
    """Physics of the sensor; the method is not told."""
    surroundings: SurroundingsName = "none"
    """Things around the target; the method is not told."""


def run(cell: AcquisitionCell, seed: int, trial: int) -> dict[str, Any]:
    """Return the row of one trial."""
    return _bench(cell, seed).acquired(range_m=cell.range_m, sampling=cell.sampling, seed=seed, trial=trial)


@lru_cache(maxsize=4)
def _bench(cell: AcquisitionCell, seed: int) -> Bench:
    lidar = lidar_config(eq4=cell.eq4)
    sensor = lidar_input(
        cell.method, step_deg=cell.step_deg, centroid=cell.centroid, matcher=cell.matcher, eq4=cell.eq4
    )
    acquiring = Acquiring(sensor, cached_target(cell.model or cell.target), pattern_of(lidar))
    things = surroundings(cell.surroundings, cached_target(cell.target), (cell.range_m, cell.range_m))
    return Bench(
        cell.target, emulator_of(cell.target, lidar, seed, world=cell.world, things=things), acquiring
    )
