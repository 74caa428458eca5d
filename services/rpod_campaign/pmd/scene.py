"""Frames of a scenario's camera at any time, with their truth."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_campaign.engine.trial.streams import stream
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.pmd.world import World, built, disturbed
from rpod_geometry.rays import Hits, RayGrid, cast
from rpod_motion.motion import Motion, build_motion
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd import MAX_RATE_HZ, PmdConfig
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.poses import make_pose
from rpod_schemas.topics import optical_frame
from rpod_schemas.types import PmdFrame
from rpod_sim_sensor.pmd import PmdEmulator
from rpod_sim_sensor.worlds import world_of

_CAD, _LOSS = 11, 12
"""Streams of random numbers."""
_NOISE_SEEDS = 1_000_003
"""Greatest number of trials of one seed; with more, two seeds would share the noise of a trial."""


@dataclass(frozen=True, eq=False)
class Shot:
    """A frame with its truth."""

    time_s: float
    """Time from the epoch to the middle of the exposure, s."""
    T_sensor_target: RigidTransform
    frame: PmdFrame
    seen: NDArray[np.bool_]
    """Pixels that see the target, shape (H, W)."""

    @property
    def depth_share(self) -> float:
        """Share of the target's pixels that have a depth; NaN if it is outside the image."""
        return float(np.isfinite(self.frame.depth_m[self.seen]).mean()) if self.seen.any() else float("nan")


def motion_of(scenario: Scenario) -> Motion:
    """Return the motion of a scenario's target."""
    target = cached_target(scenario.target)
    return build_motion(
        scenario.motion,
        centre_of_mass_m=target.centre_of_mass_m,
        inertia_kg_m2=target.inertia_kg_m2,
        duration_s=scenario.duration_s,
    )


class Stage:
    """Camera, target and motion of a scenario, in one trial of one world."""

    def __init__(self, scenario: Scenario, world: World, *, seed: int, trial: int) -> None:
        self.camera = camera_of(scenario)
        self.target = cached_target(scenario.target)
        self._world, self._seed, self._trial = world, seed, trial
        self._motion = motion_of(scenario)
        self.looked_at = built(self.target, world, stream(seed, trial, _CAD))
        self._emulator = PmdEmulator(
            self.camera,
            self.looked_at,
            seed=_NOISE_SEEDS * seed + trial,
            world=world_of(scenario.world),
            surroundings=scenario.surroundings,
        )
        self._rays = RayGrid.pinhole(self.camera.camera)
        self._hits = Hits.of(self._rays)

    def truth(self, time_s: float) -> RigidTransform:
        """Return T_sensor_target at a time."""
        return self.camera.T_chaser_sensor.inv() * self._motion.state(time_s).T_chaser_target

    def take(self, time_s: float) -> Shot:
        """Return the frame exposed around a time; its noise is that of its number at the largest rate."""
        return self.expose(
            [self.truth(time_s + offset_s) for offset_s in self.camera.pose_times_s()],
            self.truth(time_s),
            time_s=time_s,
            number=round(time_s * MAX_RATE_HZ),
        )

    def expose(
        self,
        poses: list[RigidTransform],
        T_sensor_target: RigidTransform,
        *,
        time_s: float = 0.0,
        number: int = 0,
    ) -> Shot:
        """Return the frame of a target at T_sensor_target, seen at ``poses`` in the sub-exposures."""
        sun_W_m2 = self.camera.T_chaser_sensor.rotation.inv().apply(self._motion.sun_W_m2(time_s))
        exposure = self._emulator.expose(poses, sun_W_m2=sun_W_m2, frame=number)
        frame = PmdFrame(
            stamp_ns=round(time_s * NANOSECONDS),
            frame_id=optical_frame(self.camera.name),
            depth_m=exposure.depth_m,
            amplitude=exposure.amplitude,
            camera=self.camera.camera,
            info=self.camera.info(exposure.integration_time_s),
        )
        cast(self._rays, self.looked_at.triangles_m, T_sensor_target, out=self._hits)
        seen = self._hits.triangle >= 0
        generator = np.random.default_rng((self._seed, self._trial, _LOSS, number))
        return Shot(time_s, T_sensor_target, disturbed(frame, self._world, generator, seen=seen), seen)


def still(stage: Stage, T_sensor_target: RigidTransform, *, number: int) -> Shot:
    """Return the frame of a motionless target."""
    return stage.expose([T_sensor_target] * stage.camera.sub_exposures, T_sensor_target, number=number)


def camera_of(scenario: Scenario) -> PmdConfig:
    """Return the camera of a scenario."""
    return next(sensor for sensor in scenario.sensors if isinstance(sensor, PmdConfig))


@lru_cache(maxsize=64)
def scenario_of(document: str) -> Scenario:
    """Return the scenario of a JSON document."""
    return Scenario.model_validate_json(document)


def times_s(scenario: Scenario, frames: str) -> list[float]:
    """Return the times of frames, s: keyframes, one a second, or the full rate of the scenario's camera."""
    rate_hz = 1.0 if frames == "keyframes" else fastest_hz(camera_of(scenario))
    return [number / rate_hz for number in range(int(scenario.duration_s * rate_hz))]


def fastest_hz(camera: PmdConfig) -> float:
    """Return the largest frame rate of a camera, Hz."""
    exposure_s = 2.0 * camera.latency_s - camera.readout_s
    return float(min(MAX_RATE_HZ, np.floor(1.0 / exposure_s)))


def off(pose: RigidTransform, generator: Generator, *, angle_deg: float, distance_m: float) -> RigidTransform:
    """Return a pose with an error of an angle and a distance in random directions."""
    axis, way = (vector / np.linalg.norm(vector) for vector in generator.standard_normal((2, 3)))
    return make_pose(
        rotation=Rotation.from_rotvec(np.deg2rad(angle_deg) * axis) * pose.rotation,
        translation_m=pose.translation + distance_m * way,
    )


def turned(covariance: FloatArray, R: Rotation) -> FloatArray:
    """Return the covariance of (dp, dtheta), shape (6, 6), in axes rotated by R."""
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = matrix[3:, 3:] = R.as_matrix()
    return matrix @ covariance @ matrix.T
