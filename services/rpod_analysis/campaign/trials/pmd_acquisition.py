"""A trial of acquisition in one frame of a camera: from no guess, or from a wide start."""

import time
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import polars as pl
from numpy.random import Generator
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_analysis.campaign.trials.pmd_methods import pmd_input
from rpod_analysis.campaign.trials.pmd_scene import Stage, off, scenario_of, still
from rpod_analysis.campaign.trials.pmd_world import World
from rpod_analysis.campaign.trials.scene import stream
from rpod_analysis.campaign.trials.scores import POSE, errors, numbers
from rpod_pose.methods import pmd_methods, warm_up
from rpod_pose.ports import Methods
from rpod_schemas.poses import make_pose
from rpod_target import Target

SUCCESS_DEG, SUCCESS_M = 4.0, 0.08
"""A pose nearer than both is a success."""
FRONT_DEG = 45.0
"""Half angle of the cone about the target's x axis from which its front is seen."""
WIDE_DEG, WIDE_M = 25.0, 0.5
"""How far off a wide start is."""
_ASIDE_M = 0.1
"""The middle of the target is drawn up to so far from the boresight, right or left, up or down."""
_START = 1
"""Stream of random numbers beside that of the pose."""


@dataclass(frozen=True)
class AcquisitionCell:
    """What is looked for, and from where."""

    view: str
    """front: within FRONT_DEG of the target's front; all: attitudes uniform on SO(3)."""
    start: str
    """none; or wide: from WIDE_DEG and WIDE_M off."""
    method: str
    """Of the tracker behind the search."""
    range_m: tuple[float, float]
    """From and to; of the target's middle, uniform."""
    document: str = field(repr=False)
    """The scenario with camera and sun, as JSON."""
    target: str
    """The scenario's."""


SCHEMA: dict[str, Any] = {
    "truth": POSE,
    "start": POSE,
    "found": POSE,
    "range_m": pl.Float64,
    "depth_share": pl.Float64,
    "attitude_deg": pl.Float64,
    "position_m": pl.Float64,
    "success": pl.Boolean,
    "accepted": pl.Boolean,
    "verdict": pl.String,
    "hypotheses": pl.Int64,
    "right_hypothesis": pl.Boolean,
    "reason": pl.String,
    "acquire_s": pl.Float64,
}


def run(cell: AcquisitionCell, seed: int, trial: int) -> dict[str, Any]:
    """Return the row of one frame."""
    stage, methods = _bench(cell, seed)
    truth = drawn(stage.target, cell.view, cell.range_m, stream(seed, trial))
    shot = still(stage, truth, number=trial)
    start = None
    if cell.start == "wide":
        start = off(truth, stream(seed, trial, _START), angle_deg=WIDE_DEG, distance_m=WIDE_M)
    begin_s = time.process_time()
    found = (
        methods.acquirer.acquire(shot.frame) if start is None else methods.acquirer.near(shot.frame, start)
    )
    took_s = time.process_time() - begin_s
    attitude_deg, position_m = errors(truth, found.pose, stage.target)
    return {
        "truth": numbers(truth),
        "start": numbers(start),
        "found": numbers(found.pose),
        "range_m": float(np.linalg.norm(truth.translation)),
        "depth_share": shot.depth_share,
        "attitude_deg": attitude_deg,
        "position_m": position_m,
        "success": _is_right(attitude_deg, position_m),
        "accepted": found.begins_track,
        "verdict": str(found.outcome),
        "hypotheses": len(found.hypotheses),
        "right_hypothesis": any(_is_right(*errors(truth, h.pose, stage.target)) for h in found.hypotheses),
        "reason": found.belief.reason,
        "acquire_s": took_s,
    }


def drawn(target: Target, view: str, range_m: tuple[float, float], generator: Generator) -> RigidTransform:
    """Return a random T_sensor_target with the middle of the target in view."""
    R_sensor_target = _front(generator) if view == "front" else Rotation.random(rng=generator)
    corners_m = target.triangles_m.reshape(-1, 3)
    middle_m = (corners_m.min(axis=0) + corners_m.max(axis=0)) / 2.0
    aside_m = generator.uniform(-_ASIDE_M, _ASIDE_M, 2)
    place_m = np.array((*aside_m, generator.uniform(*range_m)))
    return make_pose(rotation=R_sensor_target, translation_m=place_m - R_sensor_target.apply(middle_m))


def _front(generator: Generator) -> Rotation:
    """Return an attitude of any roll, its x axis to the camera within FRONT_DEG, evenly over that cap."""
    z = generator.uniform(np.cos(np.deg2rad(FRONT_DEG)), 1.0)
    azimuth, roll = generator.uniform(0.0, 2.0 * np.pi, 2)
    tilt = Rotation.from_rotvec(np.arccos(z) * np.array((np.cos(azimuth), np.sin(azimuth), 0.0)))
    facing = Rotation.from_euler("y", 90.0, degrees=True)  # x to -z, at the camera
    return tilt * facing * Rotation.from_euler("x", roll)


def _is_right(attitude_deg: float | None, position_m: float | None) -> bool:
    if attitude_deg is None or position_m is None:
        return False
    return attitude_deg < SUCCESS_DEG and position_m < SUCCESS_M


@lru_cache(maxsize=4)
def _bench(cell: AcquisitionCell, seed: int) -> tuple[Stage, Methods]:
    scenario = scenario_of(cell.document)
    stage = Stage(scenario, World(), seed=seed, trial=0)
    methods = pmd_methods(pmd_input(cell.method, name=stage.camera.name), stage.target)
    warm_up(methods, stage.target, None)
    return stage, methods
