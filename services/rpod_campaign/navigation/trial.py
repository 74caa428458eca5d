"""A part of a scenario, through the navigator and the integrity monitor, in this process.

The navigator starts at the true pose. The sensors' frames are made and decoded as in a facility, and follow
each other in the order of lockstep. Each frame gives a row.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
import polars as pl
from numpy.random import Generator
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_analysis.scoring.handover import Offset, beyond
from rpod_campaign.engine.trial.poses import errors, nees_of
from rpod_campaign.engine.trial.streams import stream
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.navigation.driven_motion import DrivenMotion
from rpod_campaign.pmd.scene import motion_of, scenario_of
from rpod_campaign.pmd.world import NOMINAL, World, built, disturbed
from rpod_campaign.sequences.judged import Arrived, judged
from rpod_emulator.local_sensor import LocalSensor
from rpod_geometry.rays import RayGrid, cast
from rpod_motion.motion import Motion
from rpod_pose.measurement import Measurement
from rpod_pose.methods import kind_methods, ready_methods
from rpod_pose.navigation.state import Output
from rpod_pose.ports import Methods
from rpod_schemas.config.emulator import EmulatorConfig
from rpod_schemas.config.estimator import EstimatorSettings
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.schedule import lockstep_steps
from rpod_schemas.types import Integrity, PmdFrame
from rpod_target import Target
from rpod_target.mesh.topology import unit_normals
from rpod_target.variation import Variation

FRAME = "frame"
"""Column that distinguishes the rows of a trial."""
_BEGIN, _BUILT, _NOISE, _MOUNTS, _DRIVEN, _LOSS = range(31, 37)
"""Streams of random numbers: the beginning, errors of the target, the sensors' noise, stated mounts,
accelerations, lost pixels."""


@dataclass(frozen=True)
class NavigationCell:
    """A scenario, and how its target differs from its model."""

    scenario: str
    target: str
    seconds: float
    """Length of a trial, s."""
    off_mm: float = 0.0
    """Standard deviation of what is off, mm."""
    misbuilt: str = "parts"
    """What is off: places and sizes of the ``parts``, or each coordinate of the ``surface``."""
    declared: float = 1.0
    """Tolerance that the model declares, over ``off_mm``."""
    world: str = "documented"
    rate_hz: float | None = None
    """Rate of the cameras, Hz; None for that of the scenario."""
    mounts: str = "stated"
    """Mounts that the sensors state: those of the scenario, as ``stated``, or ``drawn`` in each trial."""
    motion: str = "scenario"
    """Motion of the ``scenario``, or ``driven`` by white accelerations of the filter's densities as well."""
    case: str = "scenario"
    """Name of a case of ``pmd-robustness``, or ``scenario``."""
    pixels: World = NOMINAL
    """Pixels that the cameras lose."""
    document: str = field(default="", repr=False)
    """JSON of the scenario."""


SCHEMA: dict[str, Any] = {
    FRAME: pl.Int64,
    "time_s": pl.Float64,  # from the beginning of the scenario
    "since_s": pl.Float64,  # from the beginning of the trial
    "sensor": pl.String,
    "range_m": pl.Float64,
    "mode": pl.String,
    "accepted": pl.Boolean,
    "available": pl.Boolean,  # the protection levels are below the alert limits
    "attitude_error_deg": pl.Float64,
    "position_error_m": pl.Float64,
    "nees": pl.Float64,
    "nees_dof": pl.Int64,
    "nis": pl.Float64,
    # from the estimate before: change of the error, and its part beyond the covariance
    **dict.fromkeys(("change_deg", "change_m", "jump_deg", "jump_m"), pl.Float64),
    "seed": pl.Int64,
}


def run(cell: NavigationCell, seed: int, trial: int) -> list[dict[str, Any]]:
    """Return a row for each frame of the trial."""
    scenario, (settings, methods, model) = scenario_of(cell.document), _estimator(cell)
    target = cached_target(scenario.target)
    begin_s = float(stream(seed, trial, _BEGIN).uniform(0.0, max(0.0, scenario.duration_s - cell.seconds)))
    motion = _moved(cell, scenario, target, begin_s, stream(seed, trial, _DRIVEN))
    told = judged(
        settings,
        methods,
        model,
        _frames(cell, motion, begin_s, seed=seed, trial=trial),
        T_chaser_target=motion.state(begin_s).T_chaser_target,
    )
    rows, before = [], None
    for number, (arrived, state, output, integrity) in enumerate(told):
        truth = motion.state(_time_s(scenario, integrity.stamp_ns)).T_chaser_target
        offset = _offset(truth, output, target)
        rows.append(
            {
                FRAME: number,
                "time_s": arrived.time_s,
                "since_s": arrived.time_s - begin_s,
                "sensor": arrived.measurement.sensor,
                "mode": state.mode.name,
                "accepted": output.status.accepted,
                "nis": output.status.nis,
                "seed": seed,
                **_scored(truth, output, integrity, target),
                **_changed(before, offset),
            }
        )
        before = offset or before
    return rows


def _moved(
    cell: NavigationCell, scenario: Scenario, target: Target, begin_s: float, generator: Generator
) -> Motion | DrivenMotion:
    """Return the motion of the target."""
    motion = _motion_of(cell.document)
    if cell.motion == "scenario":
        return motion
    config, centre_m = scenario.settings.filter, target.centre_of_mass_m
    last_s = cell.seconds + max(1.0 / sensor.rate_hz for sensor in scenario.sensors)
    return DrivenMotion.drawn(motion, config, centre_m, generator, begin_s=begin_s, seconds=last_s)


def _frames(
    cell: NavigationCell, motion: Motion | DrivenMotion, begin_s: float, *, seed: int, trial: int
) -> Iterator[Arrived]:
    """Yield the measurements of a trial, with their times in the scenario, in the order of lockstep.

    Frames of a sensor that is beyond its ``range_m`` are left out, since the estimator does not use them.
    """
    scenario = scenario_of(cell.document)
    target = misbuilt(cell, cached_target(scenario.target), stream(seed, trial, _BUILT))
    sensors = {sensor.name: sensor for sensor in scenario.sensors}
    config = EmulatorConfig(
        target=scenario.target,
        sensors=scenario.sensors,
        world=scenario.world,
        surroundings=scenario.surroundings,
        seed=int(stream(seed, trial, _NOISE).integers(2**31)),
    )
    local = {name: LocalSensor(config, sensor, target) for name, sensor in sensors.items()}
    mounts = stated_mounts(cell, scenario, stream(seed, trial, _MOUNTS))
    loss = stream(seed, trial, _LOSS)
    range_m = {sensor.name: sensor.range_m or (0.0, np.inf) for sensor in scenario.estimator.sensors}
    for step in lockstep_steps(scenario.sensors, epoch_ns=scenario.epoch_ns, duration_s=scenario.duration_s):
        due, sensor = step.frame, sensors[step.frame.sensor]
        time_s = _time_s(scenario, due.stamp_ns)
        if due.sensor not in range_m or time_s < begin_s:
            continue
        if time_s > begin_s + cell.seconds:
            return
        T_sensor_chaser, (least_m, greatest_m) = sensor.T_chaser_sensor.inv(), range_m[due.sensor]
        times_s = (time_s, *(time_s + each_s for each_s in sensor.pose_times_s()))
        now, *poses = (T_sensor_chaser * motion.state(each_s).T_chaser_target for each_s in times_s)
        if not least_m <= np.linalg.norm(now.translation) <= greatest_m:
            continue
        frame = local[due.sensor].frame(poses, motion.sun_W_m2(time_s), due)
        if isinstance(frame, PmdFrame):
            frame = without_pixels(frame, cell.pixels, target, now, loss)
        if frame is not None:
            yield Arrived(time_s, Measurement(due.sensor, frame, mounts[due.sensor]))


def without_pixels(
    frame: PmdFrame, pixels: World, target: Target, T_sensor_target: RigidTransform, generator: Generator
) -> PmdFrame:
    """Return an image of a target without the pixels that are lost."""
    if pixels == NOMINAL:
        return frame
    hits = cast(RayGrid.pinhole(frame.camera), target.triangles_m, T_sensor_target)
    return disturbed(frame, pixels, generator, seen=hits.triangle >= 0)


def misbuilt(cell: NavigationCell, target: Target, generator: Generator) -> Target:
    """Return the target that the sensors see."""
    if cell.misbuilt == "parts":
        return built(target, World(cad_error_m=1e-3 * cell.off_mm), generator)
    rms_m = np.sqrt(3.0) * 1e-3 * cell.off_mm
    off = Variation(off=rms_m, seed=int(generator.integers(2**31)))
    (triangles_m,) = off.moved([target.triangles_m])
    return replace(target, triangles_m=triangles_m, normals=unit_normals(triangles_m))


def stated_mounts(
    cell: NavigationCell, scenario: Scenario, generator: Generator
) -> dict[str, RigidTransform]:
    """Return the mounts, T_chaser_sensor, that the sensors state, by the sensors' names."""
    if cell.mounts == "stated":
        return {sensor.name: sensor.published_mount for sensor in scenario.sensors}
    config = scenario.estimator.filter
    stated = {}
    for sensor in scenario.sensors:
        off_m, turn_deg = generator.standard_normal((2, 3))
        true = sensor.T_chaser_sensor
        stated[sensor.name] = RigidTransform.from_components(
            true.translation + config.mount_sigma_m * off_m,
            Rotation.from_rotvec(config.mount_sigma_deg * turn_deg, degrees=True) * true.rotation,
        )
    return stated


def _time_s(scenario: Scenario, stamp_ns: int) -> float:
    return (stamp_ns - scenario.epoch_ns) / NANOSECONDS


def _scored(truth: RigidTransform, output: Output, integrity: Integrity, target: Target) -> dict[str, Any]:
    """Return range, errors, NEES and availability of an output; errors are those at the stamp it states."""
    odometry = output.odometry
    found = None if odometry is None else odometry.pose
    attitude_deg, position_m = errors(truth, found, target)
    return {
        "range_m": float(np.linalg.norm(truth.translation)),
        "available": integrity.attitude_level_deg <= integrity.attitude_limit_deg
        and integrity.position_level_m <= integrity.position_limit_m,
        "attitude_error_deg": attitude_deg,
        "position_error_m": position_m,
        "nees": None if odometry is None else nees_of(truth, found, odometry.pose_covariance, target),
        "nees_dof": target.equivalence.dof,
    }


def _offset(truth: RigidTransform, output: Output, target: Target) -> Offset | None:
    """Return the error of an estimate with its covariance; None without one."""
    if output.odometry is None:
        return None
    found = output.odometry.pose
    same = target.equivalence.nearest_pose(truth, found)
    turn = (found.rotation * same.rotation.inv()).as_matrix()
    place_m = found.translation - same.translation
    return Offset(output.odometry.stamp_ns, turn, place_m, output.odometry.pose_covariance)


def _changed(before: Offset | None, now: Offset | None) -> dict[str, float | None]:
    """Return how far the error has changed since the estimate before, and how far beyond its covariance."""
    if before is None or now is None:
        return dict.fromkeys(("change_deg", "change_m", "jump_deg", "jump_m"))
    change_m, change_rad = before.change_to(now)
    return {
        "change_deg": float(np.degrees(np.linalg.norm(change_rad))),
        "change_m": float(np.linalg.norm(change_m)),
        "jump_deg": float(np.degrees(beyond(change_rad, before.covariance[3:, 3:]))),
        "jump_m": beyond(change_m, before.covariance[:3, :3]),
    }


@lru_cache(maxsize=4)
def _motion_of(document: str) -> Motion:
    return motion_of(scenario_of(document))


@lru_cache(maxsize=4)
def _estimator(cell: NavigationCell) -> tuple[EstimatorSettings, dict[str, Methods], Target]:
    """Return settings, methods and model of the scenario's estimator, as a facility gives them."""
    scenario = scenario_of(cell.document)
    model = cached_target(scenario.model)
    if cell.off_mm:
        model = replace(model, tolerance_m=1e-3 * cell.declared * cell.off_mm)
    emulated = {sensor.name: sensor for sensor in scenario.sensors}
    settings = scenario.settings
    methods = {}
    for sensor in settings.sensors:
        config = EmulatorConfig(target=scenario.target, sensors=(emulated[sensor.name],))
        info = LocalSensor(config, emulated[sensor.name], cached_target(scenario.target)).info
        methods[sensor.name] = ready_methods(sensor, model, kind_methods(sensor).setup(sensor, info))
    return settings, methods, model
