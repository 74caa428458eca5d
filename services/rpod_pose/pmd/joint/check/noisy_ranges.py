"""Ranges that are too noisy to measure a pose: together they tell whether its distance can be right.

A range whose noise is above ``most_noise_m`` contradicts hardly any pose, and takes no part in the
alignment. If a frame has nothing better, its edges alone measure the pose. A hundred such ranges still tell
the distance ten times as well as one of them. Their median is compared with the pose. Its interval follows
from order statistics, which hold for any distribution of the noise (W. J. Conover, Practical Nonparametric
Statistics, 1999, section 3.2).
"""

from math import hypot, nan, sqrt
from typing import NamedTuple, Self

import numpy as np

from rpod_geometry.rays import RenderBuffers
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.joint import JointAcceptanceConfig


class MedianError(NamedTuple):
    """Interval of the median by which ranges are longer than those of the target rendered at a pose, m."""

    lowest_m: float
    highest_m: float
    """Both are NaN if there are too few ranges for an interval."""
    number: int
    """Number of ranges."""

    @classmethod
    def of(cls, range_m: FloatArray, shown: RenderBuffers, sigmas: float) -> Self:
        """Return the interval from the ranges of coarse pixels that show the target.

        Args:
            range_m: ranges, NaN without one, shape (rows, columns).
            shown: the target rendered on the same pixels.
            sigmas: half the width of the interval, in standard deviations of a normal distribution.
        """
        rendered_m, owner = shown
        both = (range_m > 0.0) & (owner >= 0)
        errors_m = np.sort(range_m[both] - rendered_m[both])
        count = len(errors_m)
        first = int(np.floor(0.5 * (count - sigmas * sqrt(count)))) - 1
        if first < 0:
            return cls(nan, nan, count)
        return cls(float(errors_m[first]), float(errors_m[count - 1 - first]), count)

    def reason(
        self, limits: JointAcceptanceConfig, bias_m: float, t: FloatArray, covariance: FloatArray
    ) -> str:
        """Return why the ranges contradict a pose that the edges measure; empty if they do not.

        Args:
            limits: tolerances.
            bias_m: standard deviation of the error that all ranges share, m.
            t: position of the target, sensor axes, shape (3,), m.
            covariance: covariance of the pose, shape (6, 6).
        """
        range_m = hypot(*t)
        along = t / range_m
        sigma_m = hypot(bias_m, sqrt(max(float(along @ covariance[:3, :3] @ along), 0.0)))
        most_m = limits.bias_sigmas * sigma_m + limits.scale_share * range_m
        off_m = self.lowest_m if self.lowest_m > 0.0 else self.highest_m
        if not (self.lowest_m > most_m or self.highest_m < -most_m):
            return ""
        return (
            f"the median of {self.number} ranges, noisy ones too, is at least {off_m:+.2f} m from the "
            f"distance that the edges give, limit {most_m:.2f} m"
        )
