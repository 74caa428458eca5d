"""A trial of frame-to-frame tracking with a camera: a scenario from its first frame to its last."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np
import polars as pl
from scipy.spatial.transform import RigidTransform

from rpod_analysis.scoring.score import OFF_TARGET_M, OFF_TARGET_RAD
from rpod_campaign.engine.trial.poses import POSE, nees_of, numbers
from rpod_campaign.engine.trial.streams import stream
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.pmd.methods import pmd_input
from rpod_campaign.pmd.poses import in_proportion, limits_of
from rpod_campaign.pmd.scene import Shot, Stage, off, scenario_of, times_s, turned
from rpod_campaign.pmd.world import NOMINAL, World
from rpod_pose.belief import SYMMETRY
from rpod_pose.measurement import Measurement
from rpod_pose.methods import ready_methods
from rpod_pose.navigation.navigator import Navigator
from rpod_pose.ports import Methods, Tracker
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator import PmdInput
from rpod_schemas.poses import pose_error
from rpod_schemas.types import BeliefLevel, PmdFrame
from rpod_target import Target

START_DEG, START_M = 2.0, 0.03
"""Error of the first frame's guess in random directions: angle, deg, and distance for the mock-up, m. The
paper takes the first pose as known (section 3)."""
_START = 13
"""Stream of random numbers for the first guess."""
FRAME = "frame"
"""Column that distinguishes the rows of a sequence."""


@dataclass(frozen=True)
class SequenceCell:
    """A method in a scenario."""

    scenario: str
    method: str
    radius_px: int | None
    """First radius of the neighbour search, px; None for methods without one."""
    frames: str
    """Frames of the sequence: keyframes or full."""
    through: str
    """Source of the next guess. tracker: the last estimate; truth: the true pose of the last image, so that
    one failure does not cause the next; navigator: the prediction of its filter, which also gates."""
    document: str = field(repr=False)
    """JSON of the scenario."""
    target: str
    """Name of the scenario's target."""
    model: str = ""
    """Name of the target that the method looks for, if it is not the one that is seen."""
    case: str = ""
    """Name of the world, or of the light, in the campaign."""
    world: World = NOMINAL


SCHEMA: dict[str, Any] = {
    FRAME: pl.Int64,
    "time_s": pl.Float64,
    "range_m": pl.Float64,
    "depth_share": pl.Float64,
    "truth": POSE,
    "found": POSE,
    **dict.fromkeys(("roll_deg", "pitch_deg", "yaw_deg"), pl.Float64),  # target axes
    **dict.fromkeys(("x_m", "y_m", "z_m"), pl.Float64),  # sensor axes
    **dict.fromkeys(("sensor_roll_deg", "sensor_pitch_deg", "sensor_yaw_deg"), pl.Float64),
    **dict.fromkeys(("target_x_m", "target_y_m", "target_z_m"), pl.Float64),
    "attitude_deg": pl.Float64,
    "position_m": pl.Float64,
    "nees": pl.Float64,
    "nees_dof": pl.Int64,
    "sigma_deg": pl.Float64,  # of the covariance, in its worst direction but a free axis
    "sigma_m": pl.Float64,
    "measured": pl.Boolean,
    "off_target": pl.Boolean,
    "right": pl.Boolean,
    "believed": pl.Boolean,
    "ambiguous": pl.Boolean,
    "reason": pl.String,
    "inliers": pl.Int64,
    "iterations": pl.Int64,
    "track_s": pl.Float64,
    "seed": pl.Int64,  # with the trial's number it gives the frame again
}


class Answer(NamedTuple):
    """Result of one frame."""

    T_sensor_target: RigidTransform
    """The estimate; without a measurement, the pose that tracking continues with."""
    measured: bool
    covariance: FloatArray
    """Covariance of (dp, dtheta) in the sensor's axes, shape (6, 6); NaN if unknown."""
    reason: str = ""
    inliers: int = 0
    iterations: int = 0
    believed: bool = False
    """Whether the method accepts the estimate, or the navigator accepts the measurement."""
    ambiguous: bool = False
    """Whether other poses explain the frame as well."""


class Follower(Protocol):
    """Follows the target from frame to frame."""

    def follow(self, shot: Shot) -> Answer:
        """Return the estimate of the next frame."""
        ...


def run(cell: SequenceCell, seed: int, trial: int) -> list[dict[str, Any]]:
    """Return a row for each frame."""
    target = cached_target(scenario_of(cell.document).target)
    return [
        {FRAME: number, **_row(shot, answer, target), "track_s": took_s, "seed": seed}
        for number, (shot, answer, took_s) in enumerate(followed(cell, seed, trial))
    ]


def followed(cell: SequenceCell, seed: int, trial: int) -> Iterator[tuple[Shot, Answer, float]]:
    """Yield each frame, the method's answer, and its processor time, s."""
    scenario = scenario_of(cell.document)
    stage = Stage(scenario, cell.world, seed=seed, trial=trial)
    start_m = in_proportion(START_M, stage.target)
    first = off(stage.truth(0.0), stream(seed, trial, _START), angle_deg=START_DEG, distance_m=start_m)
    follower = _follower(cell, stage, first)
    for time_s in times_s(scenario, cell.frames):
        shot = stage.take(time_s)
        begin_s = time.process_time()
        answer = follower.follow(shot)
        yield shot, answer, time.process_time() - begin_s


class _ByTracker:
    """The last estimate is the next guess (2018 paper, Fig. 2); without a pose the last one is kept."""

    def __init__(self, tracker: Tracker[PmdFrame], first: RigidTransform) -> None:
        self._tracker, self._last = tracker, first

    def follow(self, shot: Shot) -> Answer:
        found = self._tracker.track(shot.frame, self._last)
        measured = found.continues_track
        if measured and found.T_sensor_target is not None:
            self._last = found.T_sensor_target
        belief = found.belief
        return Answer(
            self._last,
            measured,
            found.covariance,
            belief.reason,
            found.inliers,
            found.iterations,
            believed=measured and belief.level is BeliefLevel.ACCEPTED,
            ambiguous=belief.level is not BeliefLevel.ACCEPTED
            and any(not rival.exact for rival in belief.rivals),
        )


class _FromTruth(_ByTracker):
    """The true pose of the last image is the next guess, so that the error of a guess is the motion."""

    def follow(self, shot: Shot) -> Answer:
        answer = super().follow(shot)
        self._last = shot.T_sensor_target
        return answer


class _ByNavigator:
    """The navigator predicts, accepts or rejects, and filters."""

    def __init__(self, cell: SequenceCell, stage: Stage, first: RigidTransform) -> None:
        scenario = scenario_of(cell.document)
        settings, model = scenario.estimator, cached_target(scenario.model)
        self._mount, self._name = stage.camera.T_chaser_sensor, stage.camera.name
        self._navigator = Navigator(
            settings.model_copy(update={"sensors": (_input(cell),)}),
            {self._name: _methods(cell)},
            centre_of_mass_m=model.centre_of_mass_m,
            alike=model.equivalence,
        )
        self._state, self._last = self._navigator.start(self._mount * first), first

    def follow(self, shot: Shot) -> Answer:
        measurement = Measurement(self._name, shot.frame, self._mount)
        self._state, output = self._navigator.step(self._state, measurement)
        status, odometry = output.status, output.odometry
        ambiguous = any(each.name not in ("", SYMMETRY) for each in status.hypotheses)
        if odometry is None:
            unknown = np.full((6, 6), np.nan)
            return Answer(self._last, False, unknown, status.reason, status.inliers, ambiguous=ambiguous)
        to_sensor = self._mount.inv()
        self._last = to_sensor * odometry.pose
        covariance = turned(odometry.pose_covariance, to_sensor.rotation)
        return Answer(
            self._last,
            True,
            covariance,
            status.reason,
            status.inliers,
            believed=status.accepted,
            ambiguous=ambiguous,
        )


def _follower(cell: SequenceCell, stage: Stage, first: RigidTransform) -> Follower:
    if cell.through == "navigator":
        return _ByNavigator(cell, stage, first)
    follower = _FromTruth if cell.through == "truth" else _ByTracker
    return follower(_methods(cell).tracker, first)


@lru_cache(maxsize=8)
def _methods(cell: SequenceCell) -> Methods:
    return ready_methods(_input(cell), _model(cell))


def _model(cell: SequenceCell) -> Target:
    """Return the target that is looked for; its file declares how far the parts of the world are off."""
    model = cached_target(scenario_of(cell.document).model)
    return replace(model, tolerance_m=max(model.tolerance_m, cell.world.cad_error_m))


def _input(cell: SequenceCell) -> PmdInput:
    """Return the camera's input; only under the navigator do methods limit residuals, as no paper does."""
    sensors = scenario_of(cell.document).estimator.sensors
    camera = next(sensor for sensor in sensors if isinstance(sensor, PmdInput))
    limited = cell.through == "navigator"
    method = pmd_input(cell.method, radius_px=cell.radius_px, name=camera.name, limited=limited)
    return method.model_copy(update={"calibration": camera.calibration})


def _row(shot: Shot, answer: Answer, target: Target) -> dict[str, Any]:
    found = answer.T_sensor_target
    truth = target.equivalence.nearest_pose(shot.T_sensor_target, found)
    attitude_rad, position_m = pose_error(truth, found)
    in_sensor_rad = (found.rotation * truth.rotation.inv()).as_rotvec()
    in_target_m = truth.rotation.inv().apply(position_m)
    angle_rad, distance_m = float(np.linalg.norm(attitude_rad)), float(np.linalg.norm(position_m))
    observed = target.equivalence.with_free_variance(answer.covariance, found.rotation.as_matrix(), 0.0)
    return {
        "time_s": shot.time_s,
        "range_m": float(np.linalg.norm(truth.translation)),
        "depth_share": shot.depth_share,
        "truth": numbers(shot.T_sensor_target),
        "found": numbers(found),
        **_components(("roll_deg", "pitch_deg", "yaw_deg"), np.rad2deg(attitude_rad)),
        **_components(("x_m", "y_m", "z_m"), position_m),
        **_components(("sensor_roll_deg", "sensor_pitch_deg", "sensor_yaw_deg"), np.rad2deg(in_sensor_rad)),
        **_components(("target_x_m", "target_y_m", "target_z_m"), in_target_m),
        "attitude_deg": float(np.rad2deg(angle_rad)),
        "position_m": distance_m,
        "nees": nees_of(shot.T_sensor_target, found, answer.covariance, target) if answer.measured else None,
        "nees_dof": target.equivalence.dof,
        "sigma_deg": np.rad2deg(_worst_sigma(observed[3:, 3:])),
        "sigma_m": _worst_sigma(answer.covariance[:3, :3]),
        "measured": answer.measured,
        "off_target": angle_rad > OFF_TARGET_RAD or distance_m > in_proportion(OFF_TARGET_M, target),
        "right": answer.measured and limits_of(target).are_met(float(np.rad2deg(angle_rad)), distance_m),
        "believed": answer.believed,
        "ambiguous": answer.ambiguous,
        "reason": answer.reason,
        "inliers": answer.inliers,
        "iterations": answer.iterations,
    }


def _components(names: tuple[str, ...], vector: FloatArray) -> dict[str, float]:
    return dict(zip(names, vector.tolist(), strict=True))


def _worst_sigma(covariance: FloatArray) -> float:
    """Return the standard deviation in the worst direction; NaN if it is unknown."""
    if not np.isfinite(covariance).all():
        return float("nan")
    return float(np.sqrt(np.linalg.eigvalsh(covariance)[-1].clip(0.0)))
