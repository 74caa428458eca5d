"""A trial of the limits: right and wrong poses in one scan or frame, with the evidence for each.

The tracker starts near the truth, at the poses that a search proposes, at half turns of the truth, at the
truth turned by some degrees, and with the model of another satellite. Whether it believes a pose does not
count here, only the evidence.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_campaign.engine.trial.poses import errors
from rpod_campaign.engine.trial.sizes import middle_m, with_middle_at
from rpod_campaign.engine.trial.streams import stream
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.population.trial import (
    PopulationCell,
    Taken,
    lidar_methods,
    limits_of,
    measured,
    pmd_methods,
    start_of,
)
from rpod_pose.ports import Methods
from rpod_schemas.config.estimator import LidarInput, PmdInput
from rpod_schemas.config.tuning import limits_in
from rpod_target import Target

START = "start"
"""Column that distinguishes the rows of a trial."""
NEAR, SEARCHED, OTHER = "prediction", "search", "another satellite"
UNAIDED = (NEAR, SEARCHED)
"""Starts from whose right poses limits are derived; every other start may give the same pose again."""
TURNS_DEG = (8.0, 15.0, 30.0)
"""Angles by which the truth is turned about random axes."""
_INPUTS: dict[str, type[LidarInput | PmdInput]] = {"lidar": LidarInput, "pmd": PmdInput}
MOST_RIVALS = 3
"""Largest number of rivals of a search from which the tracker starts."""
_TURN = 21
"""Stream of random numbers."""


@dataclass(frozen=True)
class LimitsCell(PopulationCell):
    """A satellite, a sensor, and how limits are derived."""

    other_target: str = ""
    """Name of the satellite whose model is wrong; empty for none."""
    seed: int = 0
    quantile: float = 0.995
    """Share of right poses that a limit lets pass, before the margin."""
    margin: float = 0.1
    """Share by which a limit is wider than the quantile."""


def input_of(sensor: str) -> LidarInput | PmdInput:
    """Return the default configuration of a sensor's methods."""
    return _INPUTS[sensor]()


EVIDENCE = sorted(
    {each.limit.evidence for sensor in ("lidar", "pmd") for each in limits_in(input_of(sensor).tracking)}
)
"""Names of the numbers that the trackers' limits are compared with."""
SCHEMA: dict[str, Any] = {
    START: pl.String,
    "range_m": pl.Float64,
    "returns": pl.Int64,
    "seen": pl.Boolean,
    "attitude_deg": pl.Float64,
    "position_m": pl.Float64,
    "right": pl.Boolean,
    **dict.fromkeys(EVIDENCE, pl.Float64),
}
"""Columns of a row, one for each start of the tracker.

seen: whether the frame shows enough of the target to count. right: whether the pose is right; null if there
is none. The other columns are the evidence by name.
"""


def run(cell: LimitsCell, seed: int, trial: int) -> list[dict[str, Any]]:
    """Return the rows of one scan or frame."""
    methods, taken = measured(cell, seed, trial)
    target, limits = cached_target(cell.target), limits_of(cell, cached_target(cell.target))
    rows = []
    for name, start in _starts(cell, methods, taken, seed=seed, trial=trial):
        used = _others_methods(cell) if name == OTHER else methods
        found = used.tracker.track(taken.measurement, start)
        attitude_deg, position_m = errors(taken.truth, found.T_sensor_target, target)
        right = limits.are_met(attitude_deg, position_m) and name != OTHER
        rows.append(
            {
                START: name,
                "range_m": float(np.linalg.norm(taken.truth.apply(middle_m(target)))),
                "returns": taken.returns,
                "seen": taken.seen,
                "attitude_deg": attitude_deg,
                "position_m": position_m,
                "right": None if found.T_sensor_target is None else right,
                **{evidence: found.belief.evidence.get(evidence) for evidence in EVIDENCE},
            }
        )
    return rows


def _starts(
    cell: LimitsCell, methods: Methods, taken: Taken, *, seed: int, trial: int
) -> Iterator[tuple[str, RigidTransform]]:
    """Yield the starts of the tracker with their names."""
    target, truth = cached_target(cell.target), taken.truth
    yield NEAR, start_of(cell, truth, target, seed=seed, trial=trial)
    found = methods.acquirer.acquire(taken.measurement)
    if found.pose is not None:
        yield SEARCHED, found.pose
    for number, rival in enumerate(found.belief.rivals[:MOST_RIVALS], start=1):
        yield f"rival {number}", rival.T_sensor_target
    for axis in "xyz":
        half = Rotation.from_euler(axis, 180.0, degrees=True)
        yield f"half turn about {axis}", _turned(truth, truth.rotation * half, target)
    axes = stream(seed, trial, _TURN).standard_normal((len(TURNS_DEG), 3))
    for angle_deg, axis in zip(TURNS_DEG, axes, strict=True):
        turn = Rotation.from_rotvec(np.deg2rad(angle_deg) * axis / np.linalg.norm(axis))
        yield f"turned by {angle_deg:g} deg", _turned(truth, turn * truth.rotation, target)
    if cell.other_target:
        place_m = truth.apply(middle_m(target))
        yield OTHER, with_middle_at(truth.rotation, place_m, cached_target(cell.other_target))


def _turned(truth: RigidTransform, R_sensor_target: Rotation, target: Target) -> RigidTransform:
    """Return the truth with another attitude, its middle where it is."""
    return with_middle_at(R_sensor_target, truth.apply(middle_m(target)), target)


def _others_methods(cell: LimitsCell) -> Methods:
    """Return the methods that look for the other satellite."""
    if cell.sensor == "lidar":
        return lidar_methods(cell.target, cell.other_target, cell.wanted[1])
    return pmd_methods(cell.other_target)
