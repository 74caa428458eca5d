"""A trial along the trajectory: one of 241 positions on a safety ellipse (2015 paper, section 4.3; Fig. 5).

Both ICPs start from the same template, so that one search, by far the slowest part, serves both.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import polars as pl
from scipy.spatial.transform import RigidTransform

from rpod_campaign.engine.trial.poses import POSE, errors, numbers
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.methods import TimedSearch, lidar_config, lidar_input, pattern_of, template_search
from rpod_campaign.lidar.returns import ellipse_m
from rpod_campaign.lidar.scene import emulator_of, scan_of
from rpod_campaign.lidar.scores import is_success
from rpod_motion.motion import Motion, build_motion
from rpod_pose.methods import methods_of
from rpod_pose.ports import Registration, Tracker
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.emulator import WorldName
from rpod_schemas.config.motion import MotionConfig, StationKeepingConfig, TumbleConfig
from rpod_schemas.types import LidarScan
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_target import Target

POSITIONS, INTERVAL_S = 241, 50.0
TUMBLE_DEG_S = (0.1, 0.2, 2.67)
"""Rates of the target about its own axes at the epoch, deg/s."""
MATCHERS = {"nn": "nearest-neighbour", "ns": "normal-shooting"}
"""Names of the ICPs' matchers by the prefix of their columns."""

MOTION = MotionConfig(
    trajectory=StationKeepingConfig(least_range_m=25.0, greatest_range_m=53.0),
    attitude=TumbleConfig(rate_deg_s=np.array(TUMBLE_DEG_S)),
)
"""Assumed motion, because the paper states neither the phase on the ellipse nor the rotation of the target:
it starts straight below, with a tumble near the axis of the greatest inertia at the rate observed for ENVISAT
(one turn in 135 s)."""


@dataclass(frozen=True)
class TrajectoryCell:
    """A target that is scanned, and the method that searches for it."""

    target: str
    method: str
    eq4: str
    centroid: str
    step_deg: float
    world: WorldName = "documented"
    """Physics of the sensor; the method is not told."""


SCHEMA: dict[str, Any] = {
    "time_s": pl.Float64,
    "range_m": pl.Float64,
    "truth": POSE,
    "template": POSE,
    "template_attitude_error_deg": pl.Float64,
    "euler_raw_deg": pl.List(pl.Float64),
    "euler_wrapped_deg": pl.List(pl.Float64),
    "centroid_error_m": pl.List(pl.Float64),
    "returns": pl.Int64,
    "templates": pl.Int64,
    "excluded_share": pl.Float64,
    "search_s": pl.Float64,
    **{
        f"{icp}_{column}": kind
        for icp in MATCHERS
        for column, kind in {
            "found": POSE,
            "attitude_error_deg": pl.Float64,
            "position_error_m": pl.Float64,
            "success": pl.Boolean,
            "f_conv_m2": pl.Float64,
        }.items()
    },
}


def run(cell: TrajectoryCell, seed: int, trial: int) -> dict[str, Any]:
    """Return the row of one position."""
    emulator, search, trackers = _bench(cell, seed)
    target = cached_target(cell.target)
    truth = motion_of(cell.target).state(trial * INTERVAL_S).T_chaser_target
    scan = scan_of(emulator, truth, trial=trial)
    found = search.search(scan)
    template = found.poses[0].T_sensor_target if found.poses else None
    row: dict[str, Any] = {
        "time_s": trial * INTERVAL_S,
        "range_m": float(np.linalg.norm(truth.apply(target.centre_of_mass_m))),
        "truth": numbers(truth),
        "template": numbers(template),
        "template_attitude_error_deg": errors(truth, template, target)[0],
        **_raw_errors(truth, template),
        "returns": len(scan.returns_m),
        "templates": found.templates,
        "excluded_share": found.excluded_share,
        "search_s": search.took_s,
    }
    for icp, tracker in trackers.items():
        registration = tracker.track(scan, template) if template is not None else None
        columns = _refined(truth, registration, target)
        row |= {f"{icp}_{name}": value for name, value in columns.items()}
    return row


def _refined(truth: RigidTransform, registration: Registration | None, target: Target) -> dict[str, Any]:
    pose = registration.T_sensor_target if registration else None
    attitude_deg, position_m = errors(truth, pose, target)
    return {
        "found": numbers(pose),
        "attitude_error_deg": attitude_deg,
        "position_error_m": position_m,
        "success": is_success(attitude_deg, position_m, target),
        "f_conv_m2": None if registration is None or pose is None else registration.cost_m2,
    }


def _raw_errors(truth: RigidTransform, template: RigidTransform | None) -> dict[str, Any]:
    """Return the template's errors by the possible definitions of Tables 2 and 3.

    They are the absolute differences of roll, pitch and yaw, raw and wrapped to 180 deg at most, and those of
    the position along the sensor's axes.
    """
    if template is None:
        return {"euler_raw_deg": None, "euler_wrapped_deg": None, "centroid_error_m": None}
    raw_deg = np.abs(_euler_deg(template) - _euler_deg(truth))
    return {
        "euler_raw_deg": raw_deg.tolist(),
        "euler_wrapped_deg": np.minimum(raw_deg, 360.0 - raw_deg).tolist(),
        "centroid_error_m": np.abs(template.translation - truth.translation).tolist(),
    }


def _euler_deg(pose: RigidTransform) -> FloatArray:
    """Return roll, pitch, yaw (321), deg; at a pitch of 90 deg, where roll and yaw are equal, roll is 0."""
    angles_deg: FloatArray = pose.rotation.as_euler("ZYX", degrees=True, suppress_warnings=True)
    return angles_deg[::-1]


@lru_cache(maxsize=4)
def motion_of(target: str) -> Motion:
    """Return the assumed motion of a target over the positions."""
    loaded = cached_target(target)
    least_m, greatest_m = ellipse_m(target)
    ellipse = {"least_range_m": least_m, "greatest_range_m": greatest_m}
    trajectory = MOTION.trajectory.model_copy(update=ellipse)
    return build_motion(
        MOTION.model_copy(update={"trajectory": trajectory}),
        centre_of_mass_m=loaded.centre_of_mass_m,
        inertia_kg_m2=loaded.inertia_kg_m2,
        duration_s=(POSITIONS - 1) * INTERVAL_S,
    )


@lru_cache(maxsize=2)
def _bench(
    cell: TrajectoryCell, seed: int
) -> tuple[LidarEmulator, TimedSearch, dict[str, Tracker[LidarScan]]]:
    lidar, target = lidar_config(eq4=cell.eq4), cached_target(cell.target)
    sensors = {
        icp: lidar_input(
            cell.method, step_deg=cell.step_deg, centroid=cell.centroid, matcher=matcher, eq4=cell.eq4
        )
        for icp, matcher in MATCHERS.items()
    }
    pattern = pattern_of(lidar)
    search = TimedSearch(template_search(sensors["nn"], target, pattern))
    trackers = {icp: methods_of(sensor, target, pattern).tracker for icp, sensor in sensors.items()}
    emulator = emulator_of(cell.target, lidar, seed, world=cell.world)
    search.search(scan_of(emulator, motion_of(cell.target).state(0.0).T_chaser_target, trial=0))  # warm
    return emulator, search, trackers
