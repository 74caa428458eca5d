"""Scans of the emulated LIDAR: the hits of its rays, their detection, and their errors."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.spatial.transform import RigidTransform

from rpod_geometry.rays import RayGrid, cast
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.surroundings import Thing
from rpod_schemas.types import Float32Array
from rpod_sim_sensor.lidar.detection import echo
from rpod_sim_sensor.lidar.disturbance import bounced, false_m, mixed
from rpod_sim_sensor.lidar.noise import noisy_directions, noisy_range_m
from rpod_sim_sensor.noise import noise_stream
from rpod_sim_sensor.surroundings import Scenery, scenery
from rpod_sim_sensor.worlds import DOCUMENTED, World, lidar_cosine
from rpod_target import Target

_DISTURBED = "disturbed"
"""Suffix of a stream's name, so that a world's disturbances do not change the frame's own noise."""

Met = tuple[FloatArray, FloatArray, FloatArray]
"""Range, cosine of incidence and reflectivity at the hit of each ray, NaN without a hit."""


@dataclass(frozen=True, eq=False)
class LidarReturns:
    """One organised scan; rows are elevation, columns azimuth."""

    points_m: Float32Array
    """Measured points, sensor axes, shape (rows, columns, 3), NaN without a return."""
    intensity: Float32Array
    """Mean signal photoelectrons N_Sig (Eq. 5), shape (rows, columns), 0 without a return."""
    time_s: Float32Array
    """Time of each ray from the stamp in the middle of the scan, shape (rows, columns)."""


class LidarEmulator:
    """Scans a target. The same seed, sensor name and frame number give the same noise.

    Args:
        config: configuration of the documented sensor, from which its info message is made.
        target: the target, as documented in its file.
        seed: seed of all noise.
        world: differences of sensor and target from the documented ones, which the info message does not
            show.
        surroundings: things that the rays meet beside the target.

    Raises:
        rpod_sim_sensor.surroundings.MeshOfSurroundingsError: a mesh file cannot be read.
    """

    def __init__(
        self,
        config: LidarConfig,
        target: Target,
        *,
        seed: int,
        world: World = DOCUMENTED,
        surroundings: Sequence[Thing] = (),
    ) -> None:
        config = world.lidar_config(config)
        self._config, self._seed, self._world = config, seed, world
        self._surroundings = surroundings
        self.show(target)
        self._whole, self._rows = _grids(config, 0.0)
        self._beside = _grids(config, 0.5 * world.lidar.footprint_rad)
        self._time_s = config.ray_times_s().astype(np.float32)

    def show(self, target: Target) -> None:
        """Replace the target from now on, for example by the same one at other angles of its joints."""
        self._seen = scenery(self._world.target(target), self._surroundings, self._config.T_chaser_sensor)
        self._reflectivity = _reflectivity(self._config, self._seen)

    def scan(self, poses: Sequence[RigidTransform], *, frame: int) -> LidarReturns:
        """Return a scan.

        Args:
            poses: T_lidar_target at ``config.pose_times_s()``.
            frame: number of the scan, which with seed and sensor name determines its noise.
        """
        config, world = self._config, self._world
        generator = noise_stream(self._seed, config.name, frame)
        strange = noise_stream(self._seed, config.name + _DISTURBED, frame)
        range_m, cos_incidence, reflectivity = self._met(poses, strange)
        cos_incidence = lidar_cosine(world, cos_incidence)
        signal_e, probability = echo(
            config, reflectivity=reflectivity, cos_incidence=cos_incidence, range_m=range_m
        )
        if world.lidar.law == "hard":
            probability = np.where(np.isnan(probability), np.nan, probability >= 0.5)
        detected = generator.random(range_m.shape) < probability  # False for NaN, a ray without a hit
        if not world.lidar.is_documented:
            false = false_m(range_m, world.lidar, strange)
            detected |= np.isfinite(false)
            range_m = np.where(np.isfinite(false), false, bounced(range_m, world.lidar, strange))
        points_m = self._measured_m(range_m, generator)
        return LidarReturns(
            points_m=np.where(detected[..., None], points_m, np.nan).astype(np.float32),
            intensity=np.where(detected, np.nan_to_num(signal_e), 0.0).astype(np.float32),
            time_s=self._time_s,
        )

    def _met(self, poses: Sequence[RigidTransform], strange: Generator) -> Met:
        """Return the hit of each ray; rays with a wide beam may hit two surfaces."""
        middle = self._met_along((self._whole, self._rows), poses)
        if not self._world.lidar.footprint_rad:
            return middle
        return mixed(middle, self._met_along(self._beside, poses), self._world.lidar, strange)

    def _met_along(self, grids: tuple[RayGrid, list[RayGrid]], poses: Sequence[RigidTransform]) -> Met:
        used = [grids[0]] if len(poses) == 1 else grids[1]
        parts = [self._met_by(grid, pose) for grid, pose in zip(used, poses, strict=True)]
        range_m, cos_incidence, reflectivity = (np.concatenate(part) for part in zip(*parts, strict=True))
        return range_m, cos_incidence, reflectivity

    def _met_by(self, grid: RayGrid, T_lidar_target: RigidTransform) -> Met:
        seen = self._seen
        hits = cast(grid, seen.moving.triangles_m, T_lidar_target)
        range_m, triangle = hits.range_m, hits.triangle
        normals = T_lidar_target.rotation.apply(seen.moving.normals)
        if len(seen.still_m):
            still = cast(grid, seen.still_m, RigidTransform.identity())
            nearer = still.range_m < range_m
            range_m = np.where(nearer, still.range_m, range_m)
            triangle = np.where(nearer, still.triangle + len(normals), triangle)
            normals = np.concatenate((normals, seen.still_normals))
        met = triangle >= 0
        triangle = np.where(met, triangle, 0)
        # Either side of an open surface reflects.
        cos_incidence = np.abs((normals[triangle] * grid.directions).sum(axis=-1))
        range_m = np.where(met, range_m, np.nan)
        return np.asarray(range_m, np.float64), cos_incidence, self._reflectivity[triangle]

    def _measured_m(self, range_m: FloatArray, generator: Generator) -> FloatArray:
        """Return the measured points, (rows, columns, 3), m: ideal ranges along rays with angular errors."""
        noise = self._config.noise
        measured_m = noisy_range_m(range_m, noise, generator, self._world.noise)
        directions = noisy_directions(self._whole.directions, noise.sigma_pointing_rad, generator)
        return measured_m[..., None] * directions


def _grids(config: LidarConfig, aside_rad: float) -> tuple[RayGrid, list[RayGrid]]:
    """Return the rays of a pattern, turned by an angle in both directions, as a whole and row by row."""
    azimuth_rad, elevation_rad = config.azimuth_rad + aside_rad, config.elevation_rad + aside_rad
    rows = [
        RayGrid.azimuth_elevation(azimuth_rad, elevation_rad[row : row + 1])
        for row in range(elevation_rad.size)
    ]
    return RayGrid.azimuth_elevation(azimuth_rad, elevation_rad), rows


def _reflectivity(config: LidarConfig, seen: Scenery) -> FloatArray:
    """Return rho_T of each triangle, first of the moving and then of the fixed things, shape (T + S,)."""
    material = np.concatenate((seen.moving.triangle_material, seen.still_material))
    if config.detection.reflectivity == "mean":
        return np.full(len(material), config.detection.mean_reflectivity)
    return np.array([known.reflectivity for known in seen.moving.materials])[material]
