"""One exposure of a PMD camera: cast, collect, convert, reconstruct."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd import SAMPLES, PmdConfig
from rpod_schemas.types import Float32Array
from rpod_sim_sensor.geometry import Hits, RayGrid, SimSensorError, cast
from rpod_sim_sensor.noise import noise_stream
from rpod_sim_sensor.pmd.light import Scene, collect, lights, spread_stray_light
from rpod_sim_sensor.pmd.pixel import Electronics, convert
from rpod_sim_sensor.pmd.reconstruction import reconstruct
from rpod_target import Target


class PoseCountError(SimSensorError):
    """Not one pose for each sub-exposure."""

    def __init__(self, count: int) -> None:
        super().__init__(f"got {count} poses, an exposure needs {SAMPLES}: one at each of its pose times")


@dataclass(frozen=True, eq=False)
class PmdExposure:
    """One frame of a PMD camera; its arrays are the caller's."""

    depth_m: Float32Array
    """z-depth, shape (H, W), NaN where there is none."""
    amplitude: NDArray[np.uint16]
    """Amplitude in counts of the converter, shape (H, W)."""
    samples: NDArray[np.uint16]
    """Q1..Q4, counts from an offset of 32768, shape (H, W, 4)."""


class PmdEmulator:
    """A PMD camera that looks at a target; a frame is the same in whatever order frames are asked for."""

    def __init__(self, config: PmdConfig, target: Target, *, seed: int) -> None:
        self._config, self._target, self._seed = config, target, seed
        self._rays = RayGrid.pinhole(config.camera, config.subsamples)
        self._centres = RayGrid.pinhole(config.camera)
        self._scene = Scene(target)
        self._electronics = Electronics.of(config)
        self._hits = Hits.of(self._rays)
        self._charge_e = np.empty(self._centres.shape, np.float32)
        self._modulated_e = np.empty((*self._centres.shape, SAMPLES), np.float32)
        self._noise = np.empty_like(self._modulated_e)

    def expose(self, poses: Sequence[RigidTransform], *, sun_W_m2: FloatArray, frame: int) -> PmdExposure:
        """Return a frame.

        Args:
            poses: T_optical_target at ``config.pose_times_s()``.
            sun_W_m2: unit vector to the sun times its irradiance, optical axes, shape (3,); zeros for none.
            frame: number of the frame; with seed and name it gives the noise.

        Raises:
            PoseCountError: there is not one pose for each sub-exposure.
        """
        if len(poses) != SAMPLES:
            raise PoseCountError(len(poses))
        self._expose(poses, sun_W_m2)
        spread_stray_light(self._modulated_e, self._charge_e, self._config.lens.stray_share)
        noise_stream(self._seed, self._config.name, frame).standard_normal(out=self._noise, dtype=np.float32)
        samples, full = convert(self._modulated_e, self._charge_e, self._noise, self._electronics)
        cosine = self._centres.components[2]
        depth_m, amplitude = reconstruct(samples, self._config, cosine=cosine, full=full)
        return PmdExposure(depth_m, amplitude, samples)

    def _expose(self, poses: Sequence[RigidTransform], sun_W_m2: FloatArray) -> None:
        T_middle = _between(poses[SAMPLES // 2 - 1], poses[SAMPLES // 2])
        closed = self._target.field is not None
        cast(self._rays, self._target.triangles_m, T_middle, out=self._hits, cull_back_faces=closed)
        collect(
            self._hits.triangle,
            self._rays.components,
            self._centres.components,
            self._scene.placed(T_middle, poses),
            lights(self._config, sun_W_m2),
            modulated_e=self._modulated_e,
            charge_e=self._charge_e,
        )


def _between(first: RigidTransform, second: RigidTransform) -> RigidTransform:
    """Return the pose halfway along the screw motion from one pose to another."""
    return first * RigidTransform.from_exp_coords(0.5 * (first.inv() * second).as_exp_coords())
