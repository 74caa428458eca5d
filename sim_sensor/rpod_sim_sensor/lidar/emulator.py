"""A scan of the emulated LIDAR: what its rays meet, which come back, and with what errors."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.spatial.transform import RigidTransform

from rpod_geometry.rays import RayGrid, cast
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.types import Float32Array
from rpod_sim_sensor.lidar.detection import echo
from rpod_sim_sensor.lidar.noise import noisy_directions, noisy_range_m
from rpod_sim_sensor.noise import noise_stream
from rpod_target import Target


@dataclass(frozen=True, eq=False)
class LidarReturns:
    """One organised scan; rows are elevation, columns azimuth."""

    points_m: Float32Array
    """Sensor axes, shape (rows, columns, 3), NaN where no return."""
    intensity: Float32Array
    """Mean signal photoelectrons N_Sig (Eq. 5), shape (rows, columns), 0 where no return."""
    time_s: Float32Array
    """Of each ray, from the stamp in the middle of the scan, shape (rows, columns)."""


class LidarEmulator:
    """Scans a target. The same seed, sensor name and frame number give the same noise."""

    def __init__(self, config: LidarConfig, target: Target, *, seed: int) -> None:
        self._config, self._target, self._seed = config, target, seed
        self._grid = RayGrid.azimuth_elevation(config.azimuth_rad, config.elevation_rad)
        self._rows = [
            RayGrid.azimuth_elevation(config.azimuth_rad, config.elevation_rad[row : row + 1])
            for row in range(config.elevation_rad.size)
        ]
        self._time_s = config.ray_times_s().astype(np.float32)
        self._reflectivity = _reflectivity(config, target)

    def scan(self, poses: Sequence[RigidTransform], *, frame: int) -> LidarReturns:
        """Return a scan.

        Args:
            poses: T_lidar_target at ``config.pose_times_s()``.
            frame: its number, which with seed and sensor name gives its noise.
        """
        config = self._config
        generator = noise_stream(self._seed, config.name, frame)
        range_m, cos_incidence, reflectivity = self._met(poses)
        signal_e, probability = echo(
            config, reflectivity=reflectivity, cos_incidence=cos_incidence, range_m=range_m
        )
        detected = generator.random(range_m.shape) < probability  # not where NaN: nothing is met
        points_m = self._measured_m(range_m, generator)
        return LidarReturns(
            points_m=np.where(detected[..., None], points_m, np.nan).astype(np.float32),
            intensity=np.where(detected, signal_e, 0.0).astype(np.float32),
            time_s=self._time_s,
        )

    def _met(self, poses: Sequence[RigidTransform]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return range, cosine of incidence and reflectivity of what each ray meets, NaN where nothing."""
        grids = [self._grid] if len(poses) == 1 else self._rows
        parts = [self._met_by(grid, pose) for grid, pose in zip(grids, poses, strict=True)]
        range_m, cos_incidence, reflectivity = (np.concatenate(part) for part in zip(*parts, strict=True))
        return range_m, cos_incidence, reflectivity

    def _met_by(
        self, grid: RayGrid, T_lidar_target: RigidTransform
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        hits = cast(grid, self._target.triangles_m, T_lidar_target)
        met = hits.triangle >= 0
        triangle = np.where(met, hits.triangle, 0)
        normals = T_lidar_target.rotation.apply(self._target.normals)
        # Either side of an open surface reflects.
        cos_incidence = np.abs((normals[triangle] * grid.directions).sum(axis=-1))
        range_m = np.where(met, hits.range_m, np.nan)
        return range_m, cos_incidence, self._reflectivity[triangle]

    def _measured_m(self, range_m: FloatArray, generator: Generator) -> FloatArray:
        """Return the points as measured, shape (rows, columns, 3): the ideal ranges along rays that err."""
        noise = self._config.noise
        measured_m = noisy_range_m(range_m, noise, generator)
        directions = noisy_directions(self._grid.directions, noise.sigma_pointing_rad, generator)
        return measured_m[..., None] * directions


def _reflectivity(config: LidarConfig, target: Target) -> FloatArray:
    """Return rho_T of each triangle, shape (T,)."""
    if config.detection.reflectivity == "mean":
        return np.full(len(target.triangles_m), config.detection.mean_reflectivity)
    return np.array([material.reflectivity for material in target.materials])[target.triangle_material]
