"""Lengths of the ICP and of its self-check: they follow from the error of a range and from the target's size.

With the range error of the 2015 paper, 25 mm, they are the lengths with which its campaigns were made: 0.3 m
and 0.25 m.
"""

from dataclasses import dataclass

from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_schemas.config.lidar.methods import IcpNearestNeighbourConfig, ScanComparisonConfig
from rpod_target import Target

OUTLIER = 4.0
"""Error of an outlier, in standard deviations of a range. Paper: Opromolla et al. 2015, Table 1."""
GATE, AGREEING = 3.0, 2.5
"""Distance within which a return is no outlier, and difference of ranges that agree, in such errors. Physics:
one in 370 normal errors is larger, and one in 80."""
SETTLED = 0.004
"""Step that ends the iterations, in standard deviations of a range. Numerics: the pose moves less than any
scan can show."""


MOST_COST = 4.8
"""Largest mean squared residual, in variances of a range. Paper: Opromolla et al. 2015, section 4.5: f_MAX
is 0.003 m2."""


@dataclass(frozen=True)
class ScanLengths:
    """The lengths in use, m, and a limit of squares, m2: the configured ones, or those that follow."""

    sigma_range_m: float
    """Standard deviation of a range."""
    gate_m: float
    """Distance from the surface up to which a point is never an outlier."""
    step_m: float
    """Motion of the surface in one step below which the iterations end."""
    unobserved_m: float
    """Standard deviation of a position that no face determines."""
    max_cost_m2: float
    """Largest mean squared residual of the inliers, f_MAX, if the limits leave it out."""

    @classmethod
    def of(cls, config: IcpNearestNeighbourConfig, target: Target, pattern: ScanPattern) -> "ScanLengths":
        """Return the lengths for a target and a sensor."""
        sigma_m = config.sigma_range_m or pattern.assumed_sigma_m
        return cls(
            sigma_range_m=sigma_m,
            gate_m=config.gate_m or GATE * OUTLIER * sigma_m,
            step_m=config.step_m or SETTLED * sigma_m,
            unobserved_m=config.unobserved_m or target.radius_m,
            max_cost_m2=MOST_COST * pattern.assumed_sigma_m**2,
        )


def agreeing_m(config: ScanComparisonConfig, pattern: ScanPattern) -> float:
    """Return the largest difference of a measured and a predicted range that agree, m."""
    return config.tolerance_m or AGREEING * OUTLIER * pattern.assumed_sigma_m
