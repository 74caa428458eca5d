"""A trial of acquisition in one frame of a camera, without a guess or near a wrong one."""

import time
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import polars as pl

from rpod_campaign.engine.trial.poses import POSE, errors, numbers
from rpod_campaign.engine.trial.streams import stream
from rpod_campaign.engine.trial.surroundings import SurroundingsName
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.pmd.methods import pmd_input
from rpod_campaign.pmd.poses import drawn, in_proportion, limits_of
from rpod_campaign.pmd.scene import Stage, off, scenario_of, still
from rpod_campaign.pmd.world import World
from rpod_pose.methods import ready_methods
from rpod_pose.ports import Methods
from rpod_schemas.config.emulator import WorldName

WIDE_DEG, WIDE_M = 25.0, 0.5
"""Error of a wide start: angle, deg, and distance for the mock-up, m."""
_START = 1
"""Stream of random numbers for the start, beside that of the pose."""


@dataclass(frozen=True)
class AcquisitionCell:
    """A target, a method, and the view and start of the trials."""

    view: str
    """View of the target. front: within FRONT_DEG of its front; all: attitudes uniform on SO(3)."""
    start: str
    """Start of the search: none, or wide, with an error of WIDE_DEG and WIDE_M."""
    method: str
    """Name of the tracking method that refines the search's pose."""
    range_m: tuple[float, float]
    """Least and greatest range of the target's middle, m; uniform between them."""
    document: str = field(repr=False)
    """JSON of the scenario with camera and sun."""
    target: str
    """Name of the scenario's target."""
    model: str = ""
    """Name of the target that the method looks for, if it is not the one that is seen."""
    world: WorldName = "documented"
    """The scenario's physics of the camera; the method is not told."""
    surroundings: SurroundingsName = "none"
    """Things around the target; the method is not told."""


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
        wide_m = in_proportion(WIDE_M, stage.target)
        start = off(truth, stream(seed, trial, _START), angle_deg=WIDE_DEG, distance_m=wide_m)
    begin_s = time.process_time()
    found = (
        methods.acquirer.acquire(shot.frame) if start is None else methods.acquirer.near(shot.frame, start)
    )
    took_s = time.process_time() - begin_s
    attitude_deg, position_m = errors(truth, found.pose, stage.target)
    limits = limits_of(stage.target)
    return {
        "truth": numbers(truth),
        "start": numbers(start),
        "found": numbers(found.pose),
        "range_m": float(np.linalg.norm(truth.translation)),
        "depth_share": shot.depth_share,
        "attitude_deg": attitude_deg,
        "position_m": position_m,
        "success": limits.are_met(attitude_deg, position_m),
        "accepted": found.begins_track,
        "verdict": str(found.outcome),
        "hypotheses": len(found.hypotheses),
        "right_hypothesis": any(
            limits.are_met(*errors(truth, each.pose, stage.target)) for each in found.hypotheses
        ),
        "reason": found.belief.refusal,
        "acquire_s": took_s,
    }


@lru_cache(maxsize=4)
def _bench(cell: AcquisitionCell, seed: int) -> tuple[Stage, Methods]:
    scenario = scenario_of(cell.document)
    stage = Stage(scenario, World(), seed=seed, trial=0)
    methods = ready_methods(pmd_input(cell.method, name=stage.camera.name), cached_target(scenario.model))
    return stage, methods
