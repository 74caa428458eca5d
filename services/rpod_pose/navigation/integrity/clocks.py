"""Tests whether two sensors differ as by a clock: late stamps look like a turned or displaced mount.

Stamps that are late by tau move the measured pose by -tau (v, w), of velocity and rate. In a calm spin this
is a constant turn about the axis of the rate, as a mount that is turned about it shows it. So a difference
between two sensors that agrees with (v, w) is reported with both explanations. A motion whose direction
changes distinguishes them: then the difference does not keep to (v, w), and the clock explains a small part.

The difference along (v, w) is one number, and its test has one degree of freedom. So it notices a clock that
the test of the whole difference, with six, does not (J. Blanch et al. 2015 test each hypothesis likewise).
"""

from dataclasses import dataclass

import numpy as np

from rpod_pose.navigation.dynamics.slewing import relied_on
from rpod_pose.navigation.filter import ATTITUDE, POSE, POSITION, FilterState, separation_of
from rpod_pose.navigation.filter.rotations import cross_matrix
from rpod_pose.navigation.integrity.levels import declared_covariance
from rpod_pose.navigation.integrity.mounts import MountOffset
from rpod_pose.navigation.integrity.residuals import EXPLAINED, Statistic
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.integrity import IntegrityConfig
from rpod_schemas.poses import rotation_matrix

WRONG_ONE_UNKNOWN = "; which of them is wrong is not known: calibrate both"
"""End of the report of an offset between two mounts, with the remedy."""


@dataclass(frozen=True)
class Pair:
    """Names of the two sensors of a track."""

    one: str
    other: str


@dataclass(frozen=True)
class Late:
    """How late the stamps of one sensor are against those of another, if the clock is the cause."""

    offset_s: float
    sigma_s: float
    share: float = float("nan")
    """Share of the difference, as chi-squared, that the clock explains; NaN if it was not asked."""

    def evidence(self, pair: Pair) -> dict[str, float]:
        """Return offset and standard deviation by their names in ``estimate/integrity``."""
        told = f"{pair.other}_against_{pair.one}_stamps_late"
        return {f"{told}_s": self.offset_s, f"{told}_sigma_s": self.sigma_s}

    def describe(self, pair: Pair) -> str:
        """Return the explanation in words, with its figures."""
        word = "late" if self.offset_s > 0.0 else "early"
        return (
            f"the stamps of {pair.other} are {1e3 * abs(self.offset_s):.0f} +- {1e3 * self.sigma_s:.0f} ms "
            f"{word} against those of {pair.one}"
        )


def clock_test(
    pair: Pair,
    without_one: FilterState,
    without_other: FilterState,
    *,
    estimate: FilterState,
    config: IntegrityConfig,
) -> tuple[Statistic, Late] | None:
    """Return the test whether two solutions differ along the motion; None for a target at rest.

    The covariance of the difference contains the declared errors of both mounts and both clocks. So a
    difference beyond it is not explained by what is declared.
    """
    apart = separation_of(without_one, without_other)
    covariance = without_one.covariance[POSE, POSE] + without_other.covariance[POSE, POSE]
    place_m, moving = estimate.T_chaser_target.translation, (estimate.velocity_m_s, estimate.rate_rad_s)
    covariance = covariance + 2.0 * declared_covariance(config, place_m, *moving)
    covariance = estimate.alike.with_free_variance(covariance, rotation_matrix(estimate.T_chaser_target), 1.0)
    late = late_of(apart, covariance, estimate)
    name = f"{pair.one} and {pair.other} along the motion"
    if late is None:
        return None
    angle_deg, length_m = np.rad2deg(np.linalg.norm(apart[ATTITUDE])), np.linalg.norm(apart[POSITION])
    differ = f"; they differ by {angle_deg:.2f} deg and {1e3 * length_m:.0f} mm: mounts, or "
    cause = differ + late.describe(pair) + relied_on(estimate)
    return Statistic(name, (late.offset_s / late.sigma_s) ** 2, 1, cause), late


def mount_test(offset: MountOffset, estimate: FilterState, config: IntegrityConfig) -> Statistic:
    """Return the test whether an offset between two mounts contradicts what is declared of them."""
    cause = clock_of_mounts(offset, estimate) + WRONG_ONE_UNKNOWN
    return Statistic(offset.describe(), offset.excess(config), 6, cause)


def clock_of_mounts(offset: MountOffset, estimate: FilterState) -> str:
    """Return the clock as another explanation of an offset between mounts; empty if it explains little."""
    by = np.eye(6)
    by[POSITION, ATTITUDE] = -cross_matrix(estimate.T_chaser_target.translation)
    late = late_of(by @ offset.error, by @ offset.covariance @ by.T, estimate)
    if late is None or late.share < EXPLAINED:
        return ""
    return f", or {late.describe(Pair(offset.one, offset.other))}"


def late_of(apart: FloatArray, covariance: FloatArray, estimate: FilterState) -> Late | None:
    """Return how late stamps would be to explain a difference; None for a target that does not move.

    Args:
        apart: (dp, dtheta) from one sensor's pose to that of the sensor with late stamps, shape (6,).
        covariance: covariance of it, shape (6, 6).
        estimate: the estimate, whose velocity and rate count.
    """
    moved = -np.concatenate([estimate.velocity_m_s, estimate.rate_rad_s])
    weighted = np.linalg.solve(covariance, moved)
    information, square = float(moved @ weighted), float(apart @ np.linalg.solve(covariance, apart))
    if not (information > 0.0 and square > 0.0):
        return None
    offset_s = float(weighted @ apart) / information
    return Late(offset_s, information**-0.5, offset_s**2 * information / square)
