"""Trials of tracking: single scans with a start error, and sequences of a tumbling target."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import polars as pl
from numpy.random import Generator
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_campaign.engine.trial.poses import POSE, errors, nees_of, numbers
from rpod_campaign.engine.trial.sizes import longest_side_m
from rpod_campaign.engine.trial.streams import stream
from rpod_campaign.engine.trial.surroundings import SurroundingsName, surroundings
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.methods import lidar_config, pattern_of, tracking_input
from rpod_campaign.lidar.returns import ellipse_m
from rpod_campaign.lidar.scene import emulator_of, random_pose, scan_of
from rpod_campaign.lidar.scores import SUCCESS_DEG, is_success
from rpod_motion.motion import Motion, build_motion
from rpod_pose.measurement import Measurement
from rpod_pose.methods import ready_methods
from rpod_pose.navigation.navigator import Navigator
from rpod_pose.ports import Methods
from rpod_schemas.config.emulator import WorldName
from rpod_schemas.config.estimator import EstimatorSettings
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.config.motion import MotionConfig, StationKeepingConfig, TumbleConfig
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.poses import make_pose
from rpod_schemas.types import BeliefLevel, Mode
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_target import Target, is_shipped

OFF_DEG, OFF_M, OFF_SHARE = 5.0, 0.3, 0.03
"""Error of a single scan's start: angle, deg, and distance: m for a shipped target, over the longest side for
another one."""
FRAMES, SENSOR = 60, "lidar"
"""Number of scans of a sequence, at 1 Hz, and name of the sensor."""
_START, _TUMBLE = 1, 2
"""Streams of random numbers beside that of the pose."""


@dataclass(frozen=True)
class TrackingCell:
    """A tracker on single scans at a range, or on sequences at a tumbling rate."""

    target: str
    tracker: str
    range_m: float | None
    """Range of single scans, m; None for sequences, which follow the safety ellipse."""
    rate_deg_s: float | None
    """Tumbling rate of sequences, deg/s; None for single scans."""
    model: str = ""
    """Name of the target that the method looks for, if it is not the one that is seen."""
    world: WorldName = "documented"
    """Physics of the sensor; the method is not told."""
    surroundings: SurroundingsName = "none"
    """Things around the target; the method is not told."""


SCHEMA: dict[str, Any] = {
    "truth": POSE,
    "found": POSE,
    "attitude_error_deg": pl.Float64,
    "position_error_m": pl.Float64,
    "success": pl.Boolean,
    "accepted": pl.Boolean,
    "ambiguous": pl.Boolean,
    "nees": pl.Float64,
    "nees_dof": pl.Int64,
    "reason": pl.String,
    "returns": pl.Int64,
    "track_s": pl.Float64,
    "frames": pl.Int64,
    "rejected_frames": pl.Int64,
    "lost_frames": pl.Int64,
    "wrong_frames": pl.Int64,
    "worst_deg": pl.Float64,
}


def run(cell: TrackingCell, seed: int, trial: int) -> dict[str, Any]:
    """Return the row of one scan, or of one sequence."""
    row: dict[str, Any] = dict.fromkeys(SCHEMA)
    return row | (_single(cell, seed, trial) if cell.range_m is not None else _sequence(cell, seed, trial))


def _single(cell: TrackingCell, seed: int, trial: int) -> dict[str, Any]:
    (emulator, methods, _), target = _bench(cell, seed), cached_target(cell.target)
    truth = random_pose(
        cell.target, range_m=cell.range_m or 0.0, sampling="euler", seed=seed, trial=trial
    ).T_sensor_target
    scan = scan_of(emulator, truth, trial=trial)
    start = _off(truth, stream(seed, trial, _START), target)
    begin_s = time.perf_counter()
    registration = methods.tracker.track(scan, start)
    took_s = time.perf_counter() - begin_s
    found, belief = registration.T_sensor_target, registration.belief
    attitude_deg, position_m = errors(truth, found, target)
    return {
        "truth": numbers(truth),
        "found": numbers(found),
        "attitude_error_deg": attitude_deg,
        "position_error_m": position_m,
        "success": is_success(attitude_deg, position_m, target),
        "accepted": found is not None and belief.level is BeliefLevel.ACCEPTED,
        "ambiguous": belief.level is not BeliefLevel.ACCEPTED
        and any(not rival.exact for rival in belief.rivals),
        "nees": nees_of(truth, found, registration.covariance, target),
        "nees_dof": target.equivalence.dof,
        "reason": belief.reason,
        "returns": len(scan.returns_m),
        "track_s": took_s,
    }


def _sequence(cell: TrackingCell, seed: int, trial: int) -> dict[str, Any]:
    """Return the columns of a sequence in which the navigator tracks a tumbling target."""
    frames = list(_frames(cell, seed, trial))
    angles_deg = [angle_deg for angle_deg, _, _ in frames if angle_deg is not None]
    return {
        "frames": len(frames),
        "rejected_frames": sum(not accepted for _, accepted, _ in frames),
        "lost_frames": sum(
            not mode.has_track or angle is None or angle >= SUCCESS_DEG for angle, _, mode in frames
        ),
        "wrong_frames": sum(
            accepted and angle is not None and angle >= SUCCESS_DEG for angle, accepted, _ in frames
        ),
        "worst_deg": max(angles_deg, default=180.0),
        "attitude_error_deg": float(np.median(angles_deg)) if angles_deg else 180.0,
    }


def _frames(cell: TrackingCell, seed: int, trial: int) -> Iterator[tuple[float | None, bool, Mode]]:
    """Yield attitude error, deg, acceptance of the measurement, and mode, for each frame.

    The error is None where the navigator publishes no estimate: such a frame is lost, and no pose is wrong.
    """
    emulator, _, navigator = _bench(cell, seed)
    motion = tumbling(cell.target, cell.rate_deg_s or 0.0, stream(seed, trial, _TUMBLE))
    state = navigator.start(motion.state(0.0).T_chaser_target)
    for k in range(FRAMES):
        truth = motion.state(float(k)).T_chaser_target
        scan = scan_of(emulator, truth, trial=trial * FRAMES + k, stamp_ns=k * NANOSECONDS)
        state, output = navigator.step(state, Measurement(SENSOR, scan, make_pose()))
        believed = None if output.odometry is None else output.odometry.pose
        angle_deg = errors(truth, believed, cached_target(cell.target))[0]
        yield angle_deg, output.status.accepted, state.mode


def tumbling(target: str, rate_deg_s: float, generator: Generator) -> Motion:
    """Return a tumble at a rate about a random axis, from a random attitude and place on the ellipse."""
    loaded = cached_target(target)
    axis = Rotation.random(rng=generator).apply((1.0, 0.0, 0.0))
    least_m, greatest_m = ellipse_m(target)
    config = MotionConfig(
        trajectory=StationKeepingConfig(
            least_range_m=least_m, greatest_range_m=greatest_m, phase_deg=generator.uniform(0.0, 360.0)
        ),
        attitude=TumbleConfig(R_chaser_target=Rotation.random(rng=generator), rate_deg_s=rate_deg_s * axis),
    )
    return build_motion(
        config,
        centre_of_mass_m=loaded.centre_of_mass_m,
        inertia_kg_m2=loaded.inertia_kg_m2,
        duration_s=float(FRAMES),
    )


def off_m(target: Target) -> float:
    """Return the distance by which a single scan's start is off, m."""
    return OFF_M if is_shipped(target) else OFF_SHARE * longest_side_m(target)


def _off(truth: RigidTransform, generator: Generator, target: Target) -> RigidTransform:
    """Return a pose with an error of 5 deg and ``off_m`` in random directions."""
    turn, shift = Rotation.random(2, rng=generator).apply((1.0, 0.0, 0.0))
    return make_pose(
        rotation=Rotation.from_rotvec(np.deg2rad(OFF_DEG) * turn) * truth.rotation,
        translation_m=truth.translation + off_m(target) * shift,
    )


@lru_cache(maxsize=4)
def _bench(cell: TrackingCell, seed: int) -> tuple[LidarEmulator, Methods, Navigator]:
    lidar, sensor = lidar_config(), tracking_input(cell.tracker)
    model = cached_target(cell.model or cell.target)
    methods = ready_methods(sensor, model, pattern_of(lidar))
    navigator = Navigator(
        EstimatorSettings(sensors=(sensor,), filter=FilterConfig(errors="considered")),
        {SENSOR: methods},
        centre_of_mass_m=model.centre_of_mass_m,
        alike=model.equivalence,
    )
    span_m = ellipse_m(cell.target) if cell.range_m is None else (cell.range_m, cell.range_m)
    things = surroundings(cell.surroundings, cached_target(cell.target), span_m)
    return emulator_of(cell.target, lidar, seed, world=cell.world, things=things), methods, navigator
