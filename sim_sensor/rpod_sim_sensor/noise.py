"""Noise that depends only on seed, sensor and frame number, so the order of the frames does not change it."""

import zlib

import numpy as np


def noise_stream(seed: int, sensor: str, frame: int) -> np.random.Generator:
    """Return the random numbers of one frame of one sensor.

    Args:
        seed: seed of the run, not negative.
        sensor: name of the sensor.
        frame: number of the frame; frames before the epoch have negative numbers.
    """
    key = (seed, zlib.crc32(sensor.encode()), frame & 0xFFFF_FFFF_FFFF_FFFF)
    return np.random.Generator(np.random.SFC64(key))
