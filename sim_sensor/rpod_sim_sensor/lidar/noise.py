"""The errors of detected points: range, line of sight, outliers (2015 paper, section 3.2)."""

from math import pi

import numpy as np
from numpy.random import Generator

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.lidar import LidarNoiseConfig
from rpod_sim_sensor.worlds import DOCUMENTED, NoiseWorld

MIN_RANGE_M = 0.1
"""Least measured range, whatever its error."""


def noisy_range_m(
    range_m: FloatArray,
    noise: LidarNoiseConfig,
    generator: Generator,
    world: NoiseWorld = DOCUMENTED.noise,
) -> FloatArray:
    """Return ranges with errors, shape as given: white noise, 4-sigma outliers, gross outliers.

    Every ray draws the same number of random values for all parameters, so that runs that differ in one
    parameter remain comparable.
    """
    shape = range_m.shape
    white = world.draw(generator, shape)
    outlier = generator.random(shape) < noise.outlier_share
    gross = generator.random(shape) < noise.gross_outlier_share
    gross_m = generator.uniform(-noise.gross_outlier_m, noise.gross_outlier_m, shape)
    error_m = noise.sigma_range_m * white * np.where(outlier, noise.outlier_factor, 1.0)
    return np.maximum(range_m + np.where(gross, gross_m, error_m), MIN_RANGE_M)


def noisy_directions(directions: FloatArray, sigma_rad: float, generator: Generator) -> FloatArray:
    """Return unit vectors, shape (..., 3), rotated from the given ones by a normally distributed angle."""
    angle_rad = sigma_rad * generator.standard_normal(directions.shape[:-1])
    turn_rad = generator.uniform(0.0, 2.0 * pi, directions.shape[:-1])
    # Two axes across each ray; a LIDAR's rays never come near its own y axis, which is 90 deg of elevation.
    across = np.cross(directions, (0.0, 1.0, 0.0))
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    along = np.cross(directions, across)
    aside = np.cos(turn_rad)[..., None] * across + np.sin(turn_rad)[..., None] * along
    noisy: FloatArray = np.cos(angle_rad)[..., None] * directions + np.sin(angle_rad)[..., None] * aside
    return noisy
