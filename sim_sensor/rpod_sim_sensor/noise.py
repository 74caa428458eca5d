"""Noise that belongs to a frame, not to a run: the same whoever asks, in whatever order."""

import zlib

import numpy as np


def noise_stream(seed: int, sensor: str, frame: int) -> np.random.Generator:
    """Return the random numbers of one frame of one sensor.

    Args:
        seed: of the run, not negative.
        sensor: its name.
        frame: its number; frames before the epoch have negative ones.
    """
    key = (seed, zlib.crc32(sensor.encode()), frame & 0xFFFF_FFFF_FFFF_FFFF)
    return np.random.Generator(np.random.SFC64(key))
