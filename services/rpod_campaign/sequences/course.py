"""The course of a sequence: how the target moves, and the frames that the sensors take of it."""

from collections.abc import Hashable, Iterator
from functools import lru_cache
from math import asin, ceil, degrees, sqrt
from typing import NamedTuple, Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_campaign.engine.trial.streams import stream
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.methods import lidar_config
from rpod_campaign.lidar.returns import ellipse_m, window_of
from rpod_campaign.lidar.scene import emulator_of, scan_of
from rpod_campaign.pmd.scene import Stage, motion_of, scenario_of
from rpod_campaign.pmd.world import NOMINAL
from rpod_motion.motion import Motion, build_motion
from rpod_pose.measurement import Measurement
from rpod_schemas.config.emulator import WorldName
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.motion import ApproachConfig, MotionConfig, TumbleConfig
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.poses import make_pose
from rpod_sim_sensor.lidar import LidarEmulator

LIDAR_S, PMD_S = 40.0, 8.0
"""Length of a sequence with the LIDAR alone, and with a camera, s."""
LIDAR_START_S, PMD_START_S = 15.0, 3.0
"""Time at which a fault begins in them, s."""
PMD_HZ = 15.0
TUMBLE_DEG_S = 3.5
"""Rate of the target in sequences with the LIDAR alone, deg/s, that of ENVISAT; the camera's scenario has its
own."""
RETURNS = 120.0
"""Least number of rays that meet the target's mean silhouette at the far end of a LIDAR's sequence."""
STEPS_DEG = (1.0, 0.5, 0.25, 0.1, 0.05)
"""Steps of the LIDAR's scan, deg; the largest one that gives ``RETURNS`` is taken."""
EPOCH_S = 100.0
_MOTION = 21
"""Stream of random numbers."""


class CourseCell(Hashable, Protocol):
    """A campaign's cell whose trials are sequences."""

    @property
    def target(self) -> str:
        """Name of the target."""
        ...

    @property
    def sensor(self) -> str:
        """``lidar``, ``pmd``, or ``both``."""
        ...

    @property
    def world(self) -> WorldName:
        """Variant of the emulated sensors' physics."""
        ...

    @property
    def document(self) -> str:
        """JSON of the scenario with the camera; empty for the LIDAR alone."""
        ...


class Shown(NamedTuple):
    """A frame of a sensor before its fault."""

    time_s: float
    measurement: Measurement


def fault_start_s(sensor: str) -> float:
    """Return the time at which a fault begins in the sequences of a sensor, s."""
    return LIDAR_START_S if sensor == "lidar" else PMD_START_S


class Course:
    """The motion of a trial's target, and the frames that the sensors take of it."""

    def __init__(self, cell: CourseCell, seed: int, trial: int, *, camera_hz: float = PMD_HZ) -> None:
        self._camera_hz = camera_hz
        self._cell, self._seed, self._trial = cell, seed, trial
        self._offset_s = 0.0
        self._stage: Stage | None = None
        generator = stream(seed, trial, _MOTION)
        if not cell.document:
            self._motion = _approach(cell.target, Rotation.random(2, rng=generator))
            return
        scenario = scenario_of(cell.document)
        self._offset_s = float(generator.uniform(0.0, scenario.duration_s - PMD_S))
        self._stage = Stage(scenario, NOMINAL, seed=seed, trial=trial)

    def truth(self, time_s: float) -> RigidTransform:
        """Return T_chaser_target at a time of the sequence."""
        if self._stage is None:
            return self._motion.state(time_s).T_chaser_target
        return self._stage.camera.T_chaser_sensor * self._stage.truth(time_s + self._offset_s)

    def frames(self) -> Iterator[Shown]:
        """Yield the frames of all sensors in the order of time."""
        duration_s, rate_hz = (LIDAR_S, 1.0) if self._stage is None else (PMD_S, self._camera_hz)
        for number in range(int(duration_s * rate_hz)):
            time_s = number / rate_hz
            if self._stage is not None:
                yield self._image(self._stage, time_s)
            if self._stage is None or (self._cell.sensor == "both" and number % round(self._camera_hz) == 0):
                yield self._scan(time_s)

    def _scan(self, time_s: float) -> Shown:
        cell = self._cell
        emulator = _emulator(cell.target, cell.document, cell.world, self._seed)
        number = self._trial * round(LIDAR_S) + round(time_s)
        scan = scan_of(emulator, self.truth(time_s), trial=number, stamp_ns=_stamp_ns(time_s))
        return Shown(time_s, Measurement("lidar", scan, make_pose()))

    def _image(self, stage: Stage, time_s: float) -> Shown:
        frame = stage.take(time_s + self._offset_s).frame
        stamped = frame.model_copy(update={"stamp_ns": _stamp_ns(time_s)})
        return Shown(time_s, Measurement("pmd", stamped, stage.camera.T_chaser_sensor))


def _stamp_ns(time_s: float) -> int:
    return round((time_s + EPOCH_S) * NANOSECONDS)


def _approach(target: str, drawn: Rotation) -> Motion:
    """Return the motion of a sequence with the LIDAR alone: nearer, and tumbling about a random axis."""
    loaded = cached_target(target)
    end_m, start_m = lidar_span_m(target)
    config = MotionConfig(
        trajectory=ApproachConfig(start_m=np.array((0.0, 0.0, start_m)), end_m=np.array((0.0, 0.0, end_m))),
        attitude=TumbleConfig(
            R_chaser_target=drawn[0], rate_deg_s=TUMBLE_DEG_S * drawn[1].apply((1.0, 0.0, 0.0))
        ),
    )
    return build_motion(
        config,
        centre_of_mass_m=loaded.centre_of_mass_m,
        inertia_kg_m2=loaded.inertia_kg_m2,
        duration_s=LIDAR_S,
    )


def lidar_span_m(target: str) -> tuple[float, float]:
    """Return the least and the greatest range of a LIDAR's sequences, m: below two thirds of the ellipse."""
    least_m, greatest_m = ellipse_m(target)
    return least_m, min(greatest_m, 1.5 * least_m)


def _scenario_span_m(document: str) -> tuple[float, float]:
    """Return the least and the greatest range of a scenario, by its positions at each second, m."""
    scenario = scenario_of(document)
    motion = motion_of(scenario)
    times_s = np.append(np.arange(0.0, scenario.duration_s), scenario.duration_s)
    ranges_m = [float(np.linalg.norm(motion.state(t_s).T_chaser_target.translation)) for t_s in times_s]
    return min(ranges_m), max(ranges_m)


@lru_cache(maxsize=8)
def lidar_of(target: str, document: str = "") -> LidarConfig:
    """Return the 2015 paper's LIDAR, with a window and a step that give enough returns at the far end.

    Beside a camera the window holds the target in the camera's scenario, whose JSON is given.
    """
    least_m, greatest_m = _scenario_span_m(document) if document else lidar_span_m(target)
    wanted_deg = degrees(sqrt(window_of(target).silhouette_m2 / RETURNS) / greatest_m)
    step_deg = next((step for step in STEPS_DEG if step <= wanted_deg), STEPS_DEG[-1])
    radius_m = min(cached_target(target).radius_m, 0.95 * least_m)
    half = ceil(1.2 * degrees(asin(radius_m / least_m)) / step_deg)
    return lidar_config(step_deg=step_deg, span_deg=2 * half * step_deg)


@lru_cache(maxsize=4)
def _emulator(target: str, document: str, world: WorldName, seed: int) -> LidarEmulator:
    return emulator_of(target, lidar_of(target, document), seed, world=world)
