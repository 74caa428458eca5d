"""One exposure of a PMD camera: cast, collect, meter, convert, reconstruct."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_geometry.rays import Hits, RayGrid, cast
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd import SAMPLES, PmdConfig
from rpod_schemas.types import Float32Array
from rpod_sim_sensor.errors import SimSensorError
from rpod_sim_sensor.noise import noise_stream
from rpod_sim_sensor.pmd.light import Fragments, collect, lights
from rpod_sim_sensor.pmd.metering import exposure_share, mean_light_e
from rpod_sim_sensor.pmd.pixel import Electronics, Light, Noise, convert
from rpod_sim_sensor.pmd.reconstruction import Reconstruction, reconstruct
from rpod_sim_sensor.pmd.scene import Scene
from rpod_target import Target

_POOL = 1 << 20
"""Normal numbers that frames take their noise from: each row from a place of its own."""
_POOL_KEY = 1 << 63
"""In the place of a frame's number, which is less."""


class PoseCountError(SimSensorError):
    """Not one pose for each sub-exposure."""

    def __init__(self, count: int, needed: int) -> None:
        super().__init__(f"got {count} poses, an exposure needs {needed}: one at each of its pose times")


@dataclass(frozen=True, eq=False)
class PmdExposure:
    """One frame of a PMD camera; its arrays are the caller's."""

    images: Reconstruction
    """Depth, amplitude, and why depth is lost."""
    samples: NDArray[np.uint16]
    """Q1..Q4, counts from an offset of 32768, shape (F, H, W, 4), in the order of the frequencies."""
    integration_time_s: float
    """What the frame had: the profile's, or less where the exposure is automatic."""

    @classmethod
    def of(cls, config: PmdConfig) -> Self:
        """Return buffers for a camera's exposure."""
        shape = len(config.frequencies_hz), config.camera.height, config.camera.width, SAMPLES
        return cls(Reconstruction.of(config), np.empty(shape, np.uint16), config.integration_time_s)

    @property
    def depth_m(self) -> Float32Array:
        """z-depth, shape (H, W), NaN where there is none."""
        return self.images.depth_m

    @property
    def amplitude(self) -> NDArray[np.uint16]:
        """Amplitude in counts of the converter, shape (H, W)."""
        return self.images.amplitude


class PmdEmulator:
    """A PMD camera that looks at a target; a frame is the same in whatever order frames are asked for."""

    def __init__(self, config: PmdConfig, target: Target, *, seed: int) -> None:
        self._config, self._target, self._seed = config, target, seed
        self._rays = RayGrid.pinhole(config.camera, config.subsamples).in_single_precision()
        self._centres = RayGrid.pinhole(config.camera).in_single_precision()
        self._scene = Scene(target, config.sub_exposures)
        self._electronics = Electronics.of(config)
        self._hits = Hits.of(self._rays)
        self._fragments = Fragments.of(self._rays.shape[1] * config.subsamples)
        height, width = self._centres.shape
        self._charge_e = np.empty((height, width), np.float32)
        self._modulated_e = np.empty((config.sub_exposures, height, width), np.float32)
        self._full = np.empty((height, width), np.bool_)
        self._pool = noise_stream(seed, config.name, _POOL_KEY).standard_normal(_POOL, np.float32)

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
            frame: number of the frame; with seed and name it gives the noise.
            out: whose arrays to write into and to return; new ones where left out.

        Raises:
            PoseCountError: there is not one pose for each sub-exposure.
        """
        if len(poses) != self._config.sub_exposures:
            raise PoseCountError(len(poses), self._config.sub_exposures)
        out = out or PmdExposure.of(self._config)
        light = self._light(poses, sun_W_m2)
        convert(light, self._noise(frame), self._electronics, samples=out.samples, full=self._full)
        cosine = self._centres.components[2]
        reconstruct(out.samples, self._config, cosine=cosine, full=self._full, out=out.images)
        return PmdExposure(out.images, out.samples, light.time_share * self._config.integration_time_s)

    def _light(self, poses: Sequence[RigidTransform], sun_W_m2: FloatArray) -> Light:
        middle = len(poses) // 2
        T_middle = _between(poses[middle - 1], poses[middle])
        closed = self._target.field is not None
        cast(self._rays, self._target.triangles_m, T_middle, out=self._hits, cull_back_faces=closed)
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
        stray_e = self._config.lens.stray_share * mean_light_e(modulated_e, charge_e)
        share = exposure_share(modulated_e, charge_e, self._config, self._electronics)
        return Light(modulated_e, charge_e, stray_e, share)

    def _noise(self, frame: int) -> Noise:
        count, height, width = self._modulated_e.shape
        stream = noise_stream(self._seed, self._config.name, frame)
        return Noise(self._pool, stream.integers(_POOL - width * count, size=height))


def _between(first: RigidTransform, second: RigidTransform) -> RigidTransform:
    """Return the pose halfway between two: of the mean of two rotations the nearest rotation is taken."""
    return RigidTransform.from_matrix(0.5 * (first.as_matrix() + second.as_matrix()))
