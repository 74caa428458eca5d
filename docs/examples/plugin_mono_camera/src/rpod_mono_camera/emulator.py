"""Images of a target in the sun by a monocular camera: rendering, lens blur, shot and read noise, counts."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import RigidTransform

from rpod_mono_camera.config import MonoConfig
from rpod_schemas.arrays import FloatArray
from rpod_sim_sensor.brightness import Illumination, Renderer
from rpod_sim_sensor.noise import noise_stream
from rpod_target import Target

_FIXED = 1 << 63
"""In the place of a frame's number, which is less: what is fixed for a camera."""
_FILLED, _BRIGHT = 0.8, 99.0
"""The automatic exposure fills a pixel to this share at this percentile of the lit pixels."""
_LEAST_S = 10e-6
"""Shortest exposure."""


class MonoEmulator:
    """A camera that looks at a target; a frame is the same in whatever order frames are asked for."""

    def __init__(self, config: MonoConfig, target: Target, *, seed: int) -> None:
        self._config, self._seed = config, seed
        self._renderer = Renderer(config.camera, target, subsamples=config.subsamples)
        size = config.camera.height, config.camera.width
        fixed = noise_stream(seed, config.name, _FIXED).standard_normal(size)
        self._response = 1.0 + config.pixel.nonuniformity_share * fixed

    def expose(
        self, T_optical_target: RigidTransform, *, sun_W_m2: FloatArray, frame: int
    ) -> NDArray[np.generic]:
        """Return the image, shape (H, W), uint8 or uint16.

        Args:
            T_optical_target: in the middle of the exposure.
            sun_W_m2: unit vector to the sun times its irradiance, optical axes, shape (3,).
            frame: number of the frame; with seed and name it gives the noise.
        """
        config, pixel = self._config, self._config.pixel
        light = Illumination(config.sun_share * np.asarray(sun_W_m2), config.electrons_per_radiance_s)
        rate_e_s = self._renderer.render(T_optical_target, light)
        rate_e_s = gaussian_filter(rate_e_s, config.blur_px) if config.blur_px else rate_e_s
        time_s = self._exposure_s(rate_e_s)
        noise = noise_stream(self._seed, config.name, frame)
        mean_e = (rate_e_s * self._response + pixel.dark_e_s) * time_s
        charge_e = np.minimum(noise.poisson(np.maximum(mean_e, 0.0)), pixel.full_well_e)
        charge_e = charge_e + pixel.read_noise_e * noise.standard_normal(charge_e.shape)
        last = 2**pixel.bits - 1
        counts = np.rint(
            last * (pixel.black_share + (1.0 - pixel.black_share) * charge_e / pixel.full_well_e)
        )
        image: NDArray[np.generic] = np.clip(counts, 0, last).astype(
            np.uint8 if pixel.bits == 8 else np.uint16
        )
        return image

    def _exposure_s(self, rate_e_s: NDArray[np.float32]) -> float:
        lit = rate_e_s[rate_e_s > 0.0]
        if self._config.exposure == "fixed" or not lit.size:
            return self._config.exposure_s
        filled_s = _FILLED * self._config.pixel.full_well_e / float(np.percentile(lit, _BRIGHT))
        return float(np.clip(filled_s, _LEAST_S, self._config.exposure_s))
