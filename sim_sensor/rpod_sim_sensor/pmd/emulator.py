"""One exposure of a PMD camera: cast, collect, meter, convert, reconstruct."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_geometry.rays import Hits, RayGrid, cast, cast_triangles
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd import SAMPLES, PmdConfig
from rpod_schemas.config.surroundings import Thing
from rpod_schemas.poses import between
from rpod_schemas.types import Float32Array
from rpod_sim_sensor.errors import SimSensorError
from rpod_sim_sensor.noise import noise_stream
from rpod_sim_sensor.pmd.light import Fragments, collect, lights
from rpod_sim_sensor.pmd.metering import exposure_share, mean_light_e
from rpod_sim_sensor.pmd.pixel import Electronics, Light, Noise, convert
from rpod_sim_sensor.pmd.reconstruction import Reconstruction, reconstruct
from rpod_sim_sensor.pmd.scene import Scene
from rpod_sim_sensor.pmd.veil import add_veils
from rpod_sim_sensor.surroundings import scenery
from rpod_sim_sensor.worlds import DOCUMENTED, World
from rpod_target import Target

_POOL = 1 << 20
"""Number of normal random numbers in the pool from which frames take their noise, each row from its place."""
_POOL_KEY = 1 << 63
"""Number in the key of the pool in place of a frame's number; frame numbers are smaller."""


class PoseCountError(SimSensorError):
    """The number of poses is not that of the sub-exposures."""

    def __init__(self, count: int, needed: int) -> None:
        super().__init__(f"got {count} poses, but an exposure needs {needed}: one at each of its pose times")


@dataclass(frozen=True, eq=False)
class PmdExposure:
    """One frame of a PMD camera, whose arrays belong to the caller."""

    images: Reconstruction
    """Depth, amplitude, and the reason for lost depth."""
    samples: NDArray[np.uint16]
    """Q1..Q4, counts from an offset of 32768, shape (F, H, W, 4), in the order of the frequencies."""
    integration_time_s: float
    """Integration time of the frame: the profile's, or less with automatic exposure."""

    @classmethod
    def of(cls, config: PmdConfig) -> Self:
        """Return buffers for a camera's exposure."""
        shape = len(config.frequencies_hz), config.camera.height, config.camera.width, SAMPLES
        return cls(Reconstruction.of(config), np.empty(shape, np.uint16), config.integration_time_s)

    @property
    def depth_m(self) -> Float32Array:
        """z-depth, shape (H, W), NaN without one."""
        return self.images.depth_m

    @property
    def amplitude(self) -> NDArray[np.uint16]:
        """Amplitude in counts of the converter, shape (H, W)."""
        return self.images.amplitude


class PmdEmulator:
    """A PMD camera that looks at a target; the order in which frames are made does not change them.

    Args:
        config: configuration of the documented camera, from which its info message is made.
        target: the target, as documented in its file.
        seed: seed of all noise.
        world: differences of camera and target from the documented ones, which the info message does not
            show.
        surroundings: things that the camera sees beside the target.

    Raises:
        rpod_sim_sensor.surroundings.MeshOfSurroundingsError: a mesh file cannot be read.
    """

    def __init__(
        self,
        config: PmdConfig,
        target: Target,
        *,
        seed: int,
        world: World = DOCUMENTED,
        surroundings: Sequence[Thing] = (),
    ) -> None:
        config = world.camera_config(config)
        self._config, self._seed, self._world = config, seed, world
        self._surroundings = surroundings
        self.show(target)
        self._rays = RayGrid.pinhole(config.camera, config.subsamples).in_single_precision()
        self._centres = RayGrid.pinhole(config.camera).in_single_precision()
        self._electronics = Electronics.of(config)
        self._hits = Hits.of(self._rays)
        self._still = cast(self._rays, self._seen.still_m, RigidTransform.identity())
        self._fragments = Fragments.of(self._rays.shape[1] * config.subsamples, config.sub_exposures)
        height, width = self._centres.shape
        self._charge_e = np.empty((height, width), np.float32)
        self._modulated_e = np.empty((config.sub_exposures, height, width), np.float32)
        self._full = np.empty((height, width), np.bool_)
        self._pool = _pool(noise_stream(seed, config.name, _POOL_KEY), world)

    def show(self, target: Target) -> None:
        """Replace the target from now on, for example by the same one at other angles of its joints."""
        self._seen = scenery(self._world.target(target), self._surroundings, self._config.T_chaser_sensor)
        self._scene = Scene(self._seen, self._config.sub_exposures)

    def expose(
        self,
        poses: Sequence[RigidTransform],
        *,
        sun_W_m2: FloatArray,
        frame: int,
        out: PmdExposure | None = None,
    ) -> PmdExposure:
        """Return a frame.

        Args:
            poses: T_optical_target at ``config.pose_times_s()``.
            sun_W_m2: unit vector to the sun times its irradiance, optical axes, shape (3,); zeros for none.
            frame: number of the frame, which with seed and name determines its noise.
            out: exposure whose arrays are written and returned; by default a new one.

        Raises:
            PoseCountError: the number of poses is not that of the sub-exposures.
        """
        if len(poses) != self._config.sub_exposures:
            raise PoseCountError(len(poses), self._config.sub_exposures)
        out = out or PmdExposure.of(self._config)
        light = self._light(poses, sun_W_m2)
        convert(light, self._noise(frame), self._electronics, out.samples, self._full)
        cosine = self._centres.components[2]
        reconstruct(out.samples, self._config, cosine=cosine, full=self._full, out=out.images)
        return PmdExposure(out.images, out.samples, light.time_share * self._config.integration_time_s)

    def _light(self, poses: Sequence[RigidTransform], sun_W_m2: FloatArray) -> Light:
        middle = len(poses) // 2
        T_middle = between(poses[middle - 1], poses[middle], 0.5)
        moving_m, closed = self._seen.moving.triangles_m, self._seen.is_closed
        if not len(self._seen.still_m):
            cast_triangles(self._rays, moving_m, T_middle, out=self._hits, cull=closed)
        else:
            cast(self._rays, moving_m, T_middle, out=self._hits, cull_back_faces=closed)
            nearer = self._still.range_m < self._hits.range_m
            np.copyto(self._hits.triangle, self._still.triangle + np.int32(len(moving_m)), where=nearer)
        modulated_e, charge_e = self._modulated_e, self._charge_e
        collect(
            self._hits.triangle,
            self._rays.components,
            self._centres.components,
            self._scene.placed(T_middle, poses),
            lights(self._config, sun_W_m2),
            fragments=self._fragments,
            modulated_e=modulated_e,
            charge_e=charge_e,
        )
        add_veils(modulated_e, charge_e, self._config, self._world.camera)
        stray_e = self._config.lens.stray_share * mean_light_e(modulated_e, charge_e)
        share = exposure_share(modulated_e, charge_e, self._config, self._electronics)
        return Light(modulated_e, charge_e, stray_e, share)

    def _noise(self, frame: int) -> Noise:
        count, height, width = self._modulated_e.shape
        stream = noise_stream(self._seed, self._config.name, frame)
        return Noise(self._pool, stream.integers(_POOL - width * count, size=height))


def _pool(generator: Generator, world: World) -> Float32Array:
    """Return the pool of errors from which frames take theirs, in standard deviations, shape (P,)."""
    if world.noise == DOCUMENTED.noise:
        return generator.standard_normal(_POOL, np.float32)
    return world.noise.draw(generator, _POOL).astype(np.float32)
