"""A trial of a population: one scan or one frame of a satellite at any attitude, with or without a guess.

The range follows from the number of returns, or from the share of the image that is filled, so that
satellites of any size compare. A pose is right within limits that are relative to the satellite's size.
"""

import time
from dataclasses import dataclass, field
from functools import lru_cache
from math import exp, log
from typing import Any

import numpy as np
import polars as pl
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_campaign.engine.trial.poses import POSE, errors, nees_of, numbers
from rpod_campaign.engine.trial.sizes import Limits, displaced, longest_side_m, middle_m
from rpod_campaign.engine.trial.streams import stream
from rpod_campaign.engine.trial.surroundings import SurroundingsName, surroundings
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.methods import pattern_of
from rpod_campaign.lidar.returns import RETURNS, returns_on, scan_with_returns, window_of
from rpod_campaign.lidar.scene import emulator_of, scan_of
from rpod_campaign.pmd.framing import LEAST_PIXELS, framed, lit, range_filling, reaching
from rpod_campaign.pmd.methods import DEFAULT, pmd_input
from rpod_campaign.pmd.scene import Stage, camera_of, scenario_of, still
from rpod_campaign.pmd.world import World
from rpod_pose.belief import worst_sigma
from rpod_pose.methods import ready_methods
from rpod_pose.ports import Acquisition, Methods, Outcome, Registration
from rpod_schemas.config.emulator import WorldName
from rpod_schemas.config.estimator import LidarInput
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.config.surroundings import Thing
from rpod_schemas.types import BeliefLevel, LidarScan, PmdFrame
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_target import Target
from rpod_target.population import satellite_of

RIGHT = {"lidar": (3.0, 0.03), "pmd": (4.0, 0.04)}
"""Largest errors of a right pose by sensor: attitude, deg, and position over the longest side."""
LIDAR_OFF_DEG, LIDAR_OFF = 5.0, 0.03
"""Error of the prediction of a LIDAR's tracker: angle, deg, and distance over the longest side."""
PMD_OFF_DEG, PMD_OFF = 2.0, 0.02
"""Error of the prediction of a camera's tracker: angle, deg, and distance over the range."""
SURE_SIGMAS = 3.0
"""Standard deviations within which an error is expected: one normal error in 370 is larger."""
_DRAW, _START, _SUN = 0, 1, 2
"""Streams of random numbers."""


@dataclass(frozen=True)
class PopulationCell:
    """A satellite, a sensor and a task."""

    target: str
    """Name of the satellite, or path of a target's file."""
    sensor: str
    """lidar or pmd."""
    task: str
    """acquisition or tracking."""
    wanted: tuple[float, float]
    """Least and greatest number of returns, or share of the image's height that is filled."""
    world: WorldName = "documented"
    """Physics of the sensor; the method is not told."""
    model: str = ""
    """Name of the target that the method looks for, if it is not the one that is seen."""
    document: str = field(default="", repr=False)
    """JSON of the scenario with the camera; empty for a LIDAR."""
    surroundings: SurroundingsName = "none"
    """Things around the target; the method is not told."""


SCHEMA: dict[str, Any] = {
    "truth": POSE,
    "found": POSE,
    "kind": pl.String,
    "size_m": pl.Float64,
    "triangles": pl.Int64,
    "range_m": pl.Float64,
    "returns": pl.Int64,
    "seen": pl.Boolean,
    "attitude_deg": pl.Float64,
    "position_m": pl.Float64,
    "right": pl.Boolean,
    "coarse": pl.Boolean,
    "accepted": pl.Boolean,
    "ambiguous": pl.Boolean,
    "truth_among": pl.Boolean,
    "hypotheses": pl.Int64,
    "reason": pl.String,
    "nees": pl.Float64,
    "nees_dof": pl.Int64,
    "took_s": pl.Float64,
}
"""Columns of a row.

kind: kind of the satellite's body; empty for a target of a file. triangles: of its mesh file, or of a target.
returns: number of returns of the target alone, or of its pixels with depth. seen: whether these are enough to
count the trial; a frame with fewer than 200 pixels is counted apart. coarse: the pose's own covariance does
not promise a right position, since three of its standard deviations in the worst direction exceed the limit.
accepted: a track may begin at the pose, or the tracker's pose is believed. ambiguous: the acquisition names
rivals and begins no track. truth_among: one of its hypotheses is right.
"""


@dataclass(frozen=True)
class Taken:
    """A measurement with its truth."""

    truth: RigidTransform
    measurement: LidarScan | PmdFrame
    returns: int
    seen: bool


def run(cell: PopulationCell, seed: int, trial: int) -> dict[str, Any]:
    """Return the row of one scan or frame."""
    target = cached_target(cell.target)
    methods, taken = measured(cell, seed, trial)
    kind, triangles = _described(cell.target)
    row: dict[str, Any] = {
        "truth": numbers(taken.truth),
        "kind": kind,
        "size_m": longest_side_m(target),
        "triangles": triangles,
        "range_m": float(np.linalg.norm(taken.truth.apply(middle_m(target)))),
        "returns": taken.returns,
        "seen": taken.seen,
    }
    if cell.task == "tracking":
        start = start_of(cell, taken.truth, target, seed=seed, trial=trial)
        begin_s = time.process_time()
        tracked = methods.tracker.track(taken.measurement, start)
        row["took_s"] = time.process_time() - begin_s
        return row | _tracked(cell, tracked, taken.truth, target)
    begin_s = time.process_time()
    found = methods.acquirer.acquire(taken.measurement)
    row["took_s"] = time.process_time() - begin_s
    return row | _acquired(cell, found, taken.truth, target)


def measured(cell: PopulationCell, seed: int, trial: int) -> tuple[Methods, Taken]:
    """Return the methods of a cell, and the scan or frame of a trial."""
    return _MEASURED[cell.sensor](cell, seed, trial)


def limits_of(cell: PopulationCell, target: Target) -> Limits:
    """Return the largest errors of a right pose."""
    angle_deg, share = RIGHT[cell.sensor]
    return Limits(angle_deg, share * longest_side_m(target))


def _acquired(
    cell: PopulationCell, found: Acquisition, truth: RigidTransform, target: Target
) -> dict[str, Any]:
    limits = limits_of(cell, target)
    hypotheses = found.hypotheses
    ambiguous = found.outcome is Outcome.AMBIGUOUS and not found.begins_track
    return {
        **_scored(limits, found.registration, truth, target),
        "accepted": found.begins_track,
        "ambiguous": ambiguous,
        "truth_among": len(hypotheses) > 1
        and any(limits.are_met(*errors(truth, each.pose, target)) for each in hypotheses),
        "hypotheses": len(hypotheses),
        "reason": found.belief.refusal,
    }


def _tracked(
    cell: PopulationCell, found: Registration, truth: RigidTransform, target: Target
) -> dict[str, Any]:
    believed = found.T_sensor_target is not None and found.belief.level is BeliefLevel.ACCEPTED
    return {
        **_scored(limits_of(cell, target), found, truth, target),
        "accepted": believed,
        "ambiguous": False,
        "truth_among": False,
        "hypotheses": 0,
        "reason": found.belief.reason,
    }


def _scored(limits: Limits, found: Registration, truth: RigidTransform, target: Target) -> dict[str, Any]:
    attitude_deg, position_m = errors(truth, found.T_sensor_target, target)
    return {
        "found": numbers(found.T_sensor_target),
        "attitude_deg": attitude_deg,
        "position_m": position_m,
        "right": limits.are_met(attitude_deg, position_m),
        "coarse": SURE_SIGMAS * worst_sigma(found.covariance[:3, :3]) > limits.position_m,
        "nees": nees_of(truth, found.T_sensor_target, found.covariance, target),
        "nees_dof": target.equivalence.dof,
    }


def start_of(
    cell: PopulationCell, truth: RigidTransform, target: Target, *, seed: int, trial: int
) -> RigidTransform:
    """Return the tracker's prediction."""
    if cell.sensor == "lidar":
        angle_deg, distance_m = LIDAR_OFF_DEG, LIDAR_OFF * longest_side_m(target)
    else:
        angle_deg = PMD_OFF_DEG
        distance_m = PMD_OFF * float(np.linalg.norm(truth.apply(middle_m(target))))
    generator = stream(seed, trial, _START)
    return displaced(truth, generator, angle_deg=angle_deg, distance_m=distance_m, target=target)


def _scanned(cell: PopulationCell, seed: int, trial: int) -> tuple[Methods, Taken]:
    """Return methods and scan; the logarithm of the number of returns is uniform between the limits."""
    emulator, methods = _lidar_bench(cell, seed)
    generator = stream(seed, trial, _DRAW)
    attitude = Rotation.random(rng=generator)
    least, greatest = cell.wanted
    returns = exp(generator.uniform(log(least), log(greatest)))
    truth, scan = scan_with_returns(
        emulator, cell.target, attitude, returns=returns, trial=trial, greatest=greatest
    )
    alone = returns_on(cached_target(cell.target), truth, scan)
    if things := _things(cell, T_sensor_target=truth):
        config = window_of(cell.target, greatest).config()
        among = emulator_of(cell.target, config, seed, world=cell.world, things=things)
        scan = scan_of(among, truth, trial=trial)
    return methods, Taken(truth, scan, alone, seen=True)


def _photographed(cell: PopulationCell, seed: int, trial: int) -> tuple[Methods, Taken]:
    """Return methods and frame, in any light."""
    scenario, methods = _pmd_bench(cell)
    target = cached_target(cell.target)
    scenario = lit(scenario, stream(seed, trial, _SUN))
    truth = framed(target, camera_of(scenario), filled=cell.wanted, generator=stream(seed, trial, _DRAW))
    scenario = scenario.model_copy(update={"surroundings": _things(cell, T_sensor_target=truth)})
    stage = Stage(scenario, World(), seed=seed, trial=trial)
    shot = still(stage, truth, number=trial)
    pixels = int(np.isfinite(shot.frame.depth_m[shot.seen]).sum())
    return methods, Taken(truth, shot.frame, pixels, seen=pixels >= LEAST_PIXELS)


_MEASURED = {"lidar": _scanned, "pmd": _photographed}


def _things(cell: PopulationCell, *, T_sensor_target: RigidTransform) -> tuple[Thing, ...]:
    """Return the things around the target of a trial, sized for its range."""
    target = cached_target(cell.target)
    range_m = float(np.linalg.norm(T_sensor_target.apply(middle_m(target))))
    return surroundings(cell.surroundings, target, (range_m, range_m))


@lru_cache(maxsize=4)
def _lidar_bench(cell: PopulationCell, seed: int) -> tuple[LidarEmulator, Methods]:
    lidar = window_of(cell.target, cell.wanted[1]).config()
    emulator = emulator_of(cell.target, lidar, seed, world=cell.world)
    return emulator, lidar_methods(cell.target, cell.model or cell.target, cell.wanted[1])


@lru_cache(maxsize=4)
def _pmd_bench(cell: PopulationCell) -> tuple[Scenario, Methods]:
    target = cached_target(cell.target)
    shown = scenario_of(cell.document).model_copy(update={"target": cell.target})
    scenario = reaching(shown, range_filling(target, cell.wanted[0], camera_of(shown)))
    return scenario, pmd_methods(cell.model or cell.target)


@lru_cache(maxsize=4)
def lidar_methods(target: str, model: str, greatest: float = RETURNS[1]) -> Methods:
    """Return the default methods that look for a model in the scans of a target.

    ``greatest`` is the greatest number of returns, from which the pattern follows.
    """
    pattern = pattern_of(window_of(target, greatest).config())
    return ready_methods(LidarInput(), cached_target(model), pattern)


@lru_cache(maxsize=4)
def pmd_methods(model: str) -> Methods:
    """Return the default methods that look for a model in the frames of a camera."""
    return ready_methods(pmd_input(DEFAULT), cached_target(model))


@lru_cache(maxsize=64)
def _described(name: str) -> tuple[str, int]:
    """Return kind of body and number of triangles: of the satellite's mesh file, or of another target."""
    satellite = satellite_of(name)
    if satellite is None:
        return "", len(cached_target(name).triangles_m)
    return satellite.body, satellite.triangles
