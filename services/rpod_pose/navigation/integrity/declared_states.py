"""Tests whether what the filter has estimated of target and chaser contradicts what is declared of it.

Inertia, centre of mass, and the biases of the chaser's IMU are states, whose declared standard deviations are
their prior. Estimates of right declarations are within them: with the prior P0 and the present covariance P,
the estimate has the covariance P0 - P. So its square by P0 has at most the tail of chi-squared. If it is
beyond the limit, the prior was wrong, and so is the covariance that began with it: a ratio of inertia that is
85 % off, where 10 % are declared, is found to half of a percent, and predictions err by many times their
standard deviation. The gyro's bias is that of a star tracker and that of the filter together.
"""

from math import degrees
from typing import NamedTuple

import numpy as np

from rpod_pose.navigation.dynamics.free_motion import (
    ACCELERATION_BIAS,
    CENTRE_OF_MASS,
    GYRO_BIAS,
    INERTIA,
)
from rpod_pose.navigation.dynamics.slewing import imu_of
from rpod_pose.navigation.filter import FilterState
from rpod_pose.navigation.integrity.residuals import Statistic
from rpod_schemas.arrays import FloatArray


class _Declared(NamedTuple):
    """A quantity, its unit in words, the factor to this unit, and what to correct."""

    name: str
    unit: str
    factor: float
    remedy: str


_IMU = "check axes, sign, unit (rad/s) and stamps of chaser/imu, and its orientation, or raise "
_STATES = {
    INERTIA: _Declared(
        "the ratios of the target's inertia", "", 1.0,
        "correct inertia_kg_m2 of the target's file, or raise dynamics.inertia_sigma",
    ),
    CENTRE_OF_MASS: _Declared(
        "the target's centre of mass", " m", 1.0,
        "correct centre_of_mass_m of the target's file, or raise dynamics.centre_of_mass_sigma_m",
    ),
    GYRO_BIAS: _Declared(
        "the gyro's bias", " deg/s", degrees(1.0), f"{_IMU}dynamics.imu.gyro_bias_sigma_deg_s"
    ),
    ACCELERATION_BIAS: _Declared(
        "the accelerometer's bias", " m/s2", 1.0,
        "check axes, sign and unit of chaser/imu, or raise dynamics.imu.acceleration_bias_sigma_m_s2",
    ),
}  # fmt: skip


def declared_tests(state: FilterState) -> list[Statistic]:
    """Return the tests of all declared states of an estimate; that of the gyro's bias is of all of it."""
    imu, tests = imu_of(state.model), []
    for block in state.blocks:
        if block.name not in _STATES or not (block.sigma > 0.0).all():
            continue
        value, sigma = block.value, block.sigma
        if block.name == GYRO_BIAS and imu is not None:
            value = value + imu.bias_at(state.stamp_ns).bias_rad_s
            sigma = np.full(3, imu.bias_sigma_rad_s)
        tests.append(_test(_STATES[block.name], value, sigma))
    return tests


def _test(declared: _Declared, value: FloatArray, sigma: FloatArray) -> Statistic:
    unit = declared.unit
    off, expected = (declared.factor * float(np.linalg.norm(each)) for each in (value, sigma))
    text = (
        f"{declared.name}: estimated {off:.2g}{unit} off, {expected:.2g}{unit} expected by what is declared"
    )
    return Statistic(text, float(((value / sigma) ** 2).sum()), len(value), f"; {declared.remedy}")
