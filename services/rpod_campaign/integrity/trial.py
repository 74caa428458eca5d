"""A sequence through the navigator and the integrity monitor, in this process, with a fault.

The target tumbles and comes nearer. The navigator starts at the true pose. Each frame gives a row: errors,
protection levels, alert limits and state, so that misleading frames can be found and made again from seed,
trial and frame.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import polars as pl
from scipy.spatial.transform import Rotation

from rpod_campaign.engine.trial.poses import errors, nees_of
from rpod_campaign.engine.trial.streams import stream
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.integrity.cell import IntegrityCell
from rpod_campaign.integrity.declared import DeclaredErrors
from rpod_campaign.integrity.faults import Injector, TurnedTracker, model_of
from rpod_campaign.lidar.methods import pattern_of
from rpod_campaign.sequences.clocks import Clocks
from rpod_campaign.sequences.course import EPOCH_S, Course, lidar_of
from rpod_campaign.sequences.judged import Arrived, judged
from rpod_campaign.sequences.settings import inputs_of, settings_of
from rpod_pose.methods import ready_methods
from rpod_pose.navigation.integrity.frame_evidence import share_followed
from rpod_pose.navigation.integrity.levels import declared_covariance
from rpod_pose.navigation.state import Output
from rpod_pose.ports import Methods
from rpod_schemas.config.estimator import PmdInput
from rpod_schemas.config.estimator.integrity import IntegrityConfig
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.types import Integrity
from rpod_target import Target

FRAME = "frame"
"""Column that distinguishes the rows of a sequence."""
_TURN = 22
"""Stream of random numbers."""

SCHEMA: dict[str, Any] = {
    FRAME: pl.Int64,
    "time_s": pl.Float64,
    "by": pl.String,
    "faulty": pl.Boolean,
    "mode": pl.String,
    "state": pl.String,
    "usable": pl.Boolean,
    "reason": pl.String,
    "range_m": pl.Float64,
    "attitude_error_deg": pl.Float64,
    "position_error_m": pl.Float64,
    "attitude_level_deg": pl.Float64,
    "position_level_m": pl.Float64,
    "attitude_limit_deg": pl.Float64,
    "position_limit_m": pl.Float64,
    "harmful": pl.Boolean,  # an error is above its alert limit
    "misleading": pl.Boolean,  # an error is above its level, and the state is nominal or caution
    "nees": pl.Float64,
    "nees_dof": pl.Int64,
    "seed": pl.Int64,
}


def run(cell: IntegrityCell, seed: int, trial: int) -> list[dict[str, Any]]:
    """Return a row for each frame of the sequence."""
    course = Course(cell, seed, trial, camera_hz=cell.camera_hz)
    faulty = "lidar" if cell.sensor == "lidar" else "pmd"
    turn = Rotation.from_rotvec(cell.size * np.eye(3)[stream(seed, trial, _TURN).integers(3)], degrees=True)
    methods, turned = _turnable(_methods(cell), turn)
    settings = settings_of(cell)
    model = cached_target(model_of(cell.target, cell.fault, cell.size))
    injector = Injector(cell.fault, cell.size, start_s=cell.start_s)
    clocks = Clocks(settings, seed, trial)
    declared = {
        name: DeclaredErrors.drawn(settings.integrity, seed=seed, trial=trial, sensor=name)
        for name in methods
    }

    def arriving() -> Iterator[Arrived]:
        for time_s, exact in course.frames():
            clean = declared[exact.sensor].measured(exact)
            mine = clean.sensor == faulty
            measurement = injector.measured(time_s, clean) if mine else clean
            is_turned = mine and cell.fault == "half_turn" and injector.is_active(time_s)
            truth = exact.T_chaser_sensor.inv() * course.truth(time_s) if is_turned else None
            turned[clean.sensor].truth = truth
            clock = clocks.checked(clean.sensor, measurement.stamp_ns, EPOCH_S + time_s)
            yield Arrived(time_s, measurement, injector.repeats if mine else 0, clock)

    told = judged(settings, methods, model, arriving(), T_chaser_target=course.truth(0.0))
    return [
        {
            FRAME: number,
            "time_s": arrived.time_s,
            "by": arrived.measurement.sensor,
            "faulty": injector.is_active(arrived.time_s),
            "mode": state.mode.name,
            "seed": seed,
            **_scored(course, output, integrity, cached_target(cell.target), settings.integrity),
        }
        for number, (arrived, state, output, integrity) in enumerate(told)
    ]


def _scored(
    course: Course, output: Output, integrity: Integrity, target: Target, config: IntegrityConfig
) -> dict[str, Any]:
    """Return errors, levels and state of an output; errors are those at the stamp that it states.

    The NEES is that of the estimate's covariance and the declared errors together.
    """
    found = None if output.odometry is None else output.odometry.pose
    row: dict[str, Any] = {
        "state": integrity.state.name.lower(),
        "usable": integrity.state.is_usable,
        "reason": integrity.reason,
        "attitude_level_deg": integrity.attitude_level_deg,
        "position_level_m": integrity.position_level_m,
        "attitude_limit_deg": integrity.attitude_limit_deg,
        "position_limit_m": integrity.position_limit_m,
    }
    time_s = integrity.stamp_ns / NANOSECONDS - EPOCH_S
    truth = course.truth(time_s)
    angle_deg, distance_m = errors(truth, found, target)
    row |= {
        "range_m": float(sum(truth.translation**2) ** 0.5),
        "attitude_error_deg": angle_deg,
        "position_error_m": distance_m,
        "harmful": False,
        "misleading": False,
        "nees": None,
        "nees_dof": target.equivalence.dof,
    }
    if output.odometry is None or angle_deg is None or distance_m is None:
        return row
    twist = (output.odometry.linear_m_s, output.odometry.angular_rad_s)
    moving = [output.odometry.pose.rotation.apply(each) for each in twist]
    followed = share_followed(output.measured)
    unseen = declared_covariance(config, truth.translation, *moving, followed=followed)
    covariance = output.odometry.pose_covariance + unseen
    above_level = angle_deg > integrity.attitude_level_deg or distance_m > integrity.position_level_m
    above_limit = angle_deg > integrity.attitude_limit_deg or distance_m > integrity.position_limit_m
    return row | {
        "harmful": above_limit,
        "misleading": integrity.state.is_usable and above_level,
        "nees": nees_of(truth, found, covariance, target),
    }


@lru_cache(maxsize=4)
def _methods(cell: IntegrityCell) -> dict[str, Methods]:
    model = cached_target(model_of(cell.target, cell.fault, cell.size))
    return {
        each.name: ready_methods(each, model)
        if isinstance(each, PmdInput)
        else ready_methods(each, model, pattern_of(lidar_of(cell.target, cell.document)))
        for each in inputs_of(cell)
    }


def _turnable(
    methods: dict[str, Methods], turn: Rotation
) -> tuple[dict[str, Methods], dict[str, TurnedTracker]]:
    """Return the methods with trackers that may be turned, and these trackers, by the sensor's name."""
    turned = {name: TurnedTracker(each.tracker, turn) for name, each in methods.items()}
    return {name: replace(each, tracker=turned[name]) for name, each in methods.items()}, turned
