"""Light that reaches a pixel of a PMD camera from its surroundings: lens glare, and second reflections.

Both take a share of each pixel's light and spread it over the surrounding pixels. Glare keeps its phase.
Light that was reflected twice arrives later: the phase of its correlation changes by 2 pi (2 f / c) d for a
path that is longer by d. The third harmonic, a few percent of the light, gets the same phase change as the
first.
"""

import numpy as np
from scipy import constants
from scipy.ndimage import uniform_filter

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd import SAMPLES, PmdConfig
from rpod_schemas.types import Float32Array
from rpod_sim_sensor.worlds import CameraWorld

_PASSES = 2
"""Number of box filters: two give a halo that decreases linearly."""


def add_veils(
    modulated_e: Float32Array, charge_e: Float32Array, config: PmdConfig, world: CameraWorld
) -> None:
    """Spread light to neighbouring pixels as a world defines it, in place.

    Args:
        modulated_e: correlation of the light with the modulation, electrons, shape (K, H, W), at 0, 180, 90
            and 270 deg of each frequency in turn.
        charge_e: all electrons of a sub-exposure, shape (H, W).
        config: configuration of the camera.
        world: shares that are spread, and their radii.
    """
    width = charge_e.shape[1]
    if world.bounced_share:  # only from surface to surface: the background stays dark
        turns = 2.0 * np.array(config.frequencies_hz) / constants.c * world.detour_m
        share = np.where(charge_e > 0.0, np.float32(world.bounced_share), np.float32(0.0))
        _spread(modulated_e, charge_e, share, width * world.bounced_radius, turns)
    if world.glare_share:
        turns = np.zeros(len(config.frequencies_hz))
        share = np.full_like(charge_e, world.glare_share)
        _spread(modulated_e, charge_e, share, width * world.glare_radius, turns)


def _spread(
    modulated_e: Float32Array,
    charge_e: Float32Array,
    share: Float32Array,
    radius_px: float,
    turns: FloatArray,
) -> None:
    """Replace a share of each pixel's light, shape (H, W), by that of its surroundings, delayed by turns."""
    kept, halo = 1.0 - share, _halo(charge_e, radius_px)
    charge_e *= kept
    charge_e += share * halo
    for number, delay in enumerate(turns):
        quad = modulated_e[SAMPLES * number : SAMPLES * (number + 1)]
        cosine = _halo(0.5 * (quad[0] - quad[1]), radius_px)
        sine = _halo(0.5 * (quad[2] - quad[3]), radius_px)
        c, s = np.cos(2.0 * np.pi * delay), np.sin(2.0 * np.pi * delay)
        late = (c * cosine - s * sine, s * cosine + c * sine)
        quad *= kept
        for k, sign in enumerate((1.0, -1.0)):
            quad[k] += sign * share * late[0]
            quad[2 + k] += sign * share * late[1]


def _halo(image: Float32Array, radius_px: float) -> Float32Array:
    """Return a blurred image; light that leaves the image is lost."""
    size = max(3, round(radius_px))
    for _ in range(_PASSES):
        image = uniform_filter(image, size, mode="constant")
    return image
