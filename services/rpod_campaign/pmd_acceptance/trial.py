"""A trial of the camera's acceptance: are right poses accepted, and frames of other objects rejected?

One random frame, changed or not, is given to both: the acquisition without a guess, and the tracker with an
error of a degree and a centimetre from the true pose.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import polars as pl
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_campaign.engine.trial.poses import POSE, errors, numbers
from rpod_campaign.engine.trial.streams import stream
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.pmd.methods import DEFAULT, pmd_input
from rpod_campaign.pmd.poses import drawn, in_proportion, limits_of
from rpod_campaign.pmd.scene import Stage, camera_of, off, scenario_of, still
from rpod_campaign.pmd.world import World
from rpod_geometry.rays import RayGrid, cast
from rpod_pose.methods import ready_methods
from rpod_pose.pmd.joint.check.frame_check import SeenPixels, contradictions
from rpod_pose.pmd.rendering import Rendering
from rpod_pose.ports import Methods, Outcome
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.motion import SunConfig
from rpod_schemas.config.pmd.check import PmdCheckConfig
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.types import Camera, PmdFrame
from rpod_target import Target

OFF_DEG, OFF_M = 1.0, 0.01
"""Error of the tracker's start: angle, deg, and distance, m."""
_DRAW, _START, _SUN = 0, 1, 2
"""Streams of random numbers."""
_EXACT = PmdCheckConfig(tolerance_share=0.032)
"""Tolerance within which two images without noise count as the same: 3 cm for the mock-up."""
_EVERY = 3
"""Stride of the compared pixels, that of the tracker at 5 m: the remaining error of the pose is smaller."""

Flip = Callable[[NDArray[Any]], NDArray[Any]]
FLIPS: Mapping[str, Flip] = {"": np.asarray, "left-right": np.fliplr, "upside-down": np.flipud}
"""Ways to mirror images, by name."""


@dataclass(frozen=True)
class AcceptanceCell:
    """Content of the frames, and the target that is searched."""

    case: str
    document: str = field(repr=False)
    """JSON of the scenario with the camera; its target is searched."""
    target: str
    """Name of the target in the frames."""
    range_m: tuple[float, float]
    """Least and greatest range of the target's middle, m; uniform between them."""
    world: World
    flip: str = ""
    focal_share: float = 1.0
    """Focal lengths that the estimator is given, over the true ones."""
    sun: str = "anywhere"
    """Direction of the sun: anywhere, or behind the camera."""

    @property
    def spoiled(self) -> bool:
        """Whether the frame shows something else than the target as the camera sees it."""
        looked_for = scenario_of(self.document).target
        altered = self.target != looked_for or self.world.scale != 1.0
        return altered or bool(self.flip) or self.focal_share != 1.0


SCHEMA: dict[str, Any] = {
    "truth": POSE,
    "range_m": pl.Float64,
    "depth_share": pl.Float64,
    **{
        f"{name}_{what}": kind
        for name in ("acquisition", "tracker")
        for what, kind in (
            ("accepted", pl.Boolean),
            ("right", pl.Boolean),
            ("reason", pl.String),
            ("attitude_deg", pl.Float64),
            ("position_m", pl.Float64),
            ("alike", pl.Boolean),
        )
    },
    "tracked_after": pl.Boolean,
    "ambiguous": pl.Boolean,
}
"""Columns of a row.

alike: the target at the found pose, refined by the tracker, has the same ranges and outline as the object in
the frame, within 3 cm; their shapes cannot be distinguished. Null if no pose was found. tracked_after: the
acquisition's pose is accepted, and then the tracker's pose from there in the same frame.
"""


def run(cell: AcceptanceCell, seed: int, trial: int) -> dict[str, Any]:
    """Return the row of one frame with any attitude and any direction of the sun."""
    scenario, methods = scenario_of(cell.document), _methods(cell)
    shown = _lit(scenario, cell.sun, stream(seed, trial, _SUN)).model_copy(update={"target": cell.target})
    stage = Stage(shown, cell.world, seed=seed, trial=trial)
    looked_for = cached_target(scenario.target)
    truth = drawn(looked_for, "all", cell.range_m, stream(seed, trial, _DRAW))
    shot = still(stage, truth, number=trial)
    frame = _with_fault(shot.frame, cell)
    off_m = in_proportion(OFF_M, looked_for)
    start = off(truth, stream(seed, trial, _START), angle_deg=OFF_DEG, distance_m=off_m)
    found, tracked = methods.acquirer.acquire(frame), methods.tracker.track(frame, start)
    rays = RayGrid.pinhole(stage.camera.camera)
    seen_m = FLIPS[cell.flip](cast(rays, stage.looked_at.triangles_m, truth).range_m)
    row: dict[str, Any] = {
        "truth": numbers(truth),
        "range_m": float(np.linalg.norm(truth.translation)),
        "depth_share": shot.depth_share,
    }
    off_found = errors(truth, found.pose, looked_for)
    row |= _checked("acquisition", found.begins_track, found.belief.reason, off_found, looked_for)
    refusal = "" if tracked.begins_track else tracked.belief.refusal
    row |= _checked(
        "tracker", not refusal, refusal, errors(truth, tracked.T_sensor_target, looked_for), looked_for
    )
    refined = None
    row["tracked_after"] = False
    row["ambiguous"] = found.outcome is Outcome.AMBIGUOUS and not found.begins_track
    if found.pose is not None:
        then = methods.tracker.track(frame, found.pose)
        refined = then.T_sensor_target
        row["tracked_after"] = found.begins_track and then.begins_track
    for name, pose in (("acquisition", refined), ("tracker", tracked.T_sensor_target)):
        row[f"{name}_alike"] = None if pose is None else _alike(seen_m, frame.camera, looked_for, pose)
    return row


def _checked(
    name: str, accepted: bool, reason: str, off: tuple[float | None, float | None], target: Target
) -> dict[str, Any]:
    """Return the columns of the acquisition or of the tracker."""
    attitude_deg, position_m = off
    return {
        f"{name}_accepted": accepted,
        f"{name}_right": limits_of(target).are_met(attitude_deg, position_m),
        f"{name}_reason": reason,
        f"{name}_attitude_deg": attitude_deg,
        f"{name}_position_m": position_m,
    }


def _lit(scenario: Scenario, sun: str, generator: Generator) -> Scenario:
    """Return a scenario with the sun in any direction, or behind a camera that looks along z."""
    direction = generator.standard_normal(3) if sun == "anywhere" else np.array((0.0, 0.0, -1.0))
    light = SunConfig(direction=direction / np.linalg.norm(direction))
    return scenario.model_copy(update={"motion": scenario.motion.model_copy(update={"sun": light})})


def _with_fault(frame: PmdFrame, cell: AcceptanceCell) -> PmdFrame:
    camera, flipped = frame.camera, FLIPS[cell.flip]
    focal = {"fx": cell.focal_share * camera.fx, "fy": cell.focal_share * camera.fy}
    images = {"depth_m": np.ascontiguousarray(flipped(frame.depth_m))}
    if frame.amplitude is not None:
        images["amplitude"] = np.ascontiguousarray(flipped(frame.amplitude))
    return frame.model_copy(update={**images, "camera": camera.model_copy(update=focal)})


def _alike(seen_m: FloatArray, camera: Camera, target: Target, pose: RigidTransform) -> bool:
    """Return whether the measured ranges, inf for the sky, and outline agree with the expected ones."""
    grid = RayGrid(np.ascontiguousarray(RayGrid.pinhole(camera).components[:, ::_EVERY, ::_EVERY]))
    hits, matrix = cast(grid, target.triangles_m, pose, cull_back_faces=True), pose.as_matrix()
    R, t = matrix[:3, :3].copy(), matrix[:3, 3].copy()
    expected = Rendering(hits.range_m, hits.triangle, grid, _EVERY, camera.fx, target.triangles_m, R, t)
    seen_m = seen_m[::_EVERY, ::_EVERY]
    measured_m = np.where(np.isfinite(seen_m), seen_m, np.nan)
    shade = np.where(np.isfinite(seen_m), 1.0, 0.1)
    seen = SeenPixels(measured_m, np.zeros(seen_m.shape), shade)
    there = contradictions(seen, expected, _EXACT, radius_m=target.radius_m, typical=1.0)
    return not there.reason(_EXACT)


@lru_cache(maxsize=4)
def _methods(cell: AcceptanceCell) -> Methods:
    scenario = scenario_of(cell.document)
    target = cached_target(scenario.target)
    return ready_methods(pmd_input(DEFAULT, name=camera_of(scenario).name), target)
