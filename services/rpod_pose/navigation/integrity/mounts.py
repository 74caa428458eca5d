"""Offsets between the mounts of two sensors, as the filter estimates them.

The error of each sensor's mount is a state of the filter. Only the difference of two such errors is
observable: it shows by how much two sensors disagree, but not which of them is wrong. Along the line of
sight, a wrong position of a mount has the same effect as ranges that are all too long. The offset contains
both.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from rpod_pose.navigation.filter import FilterState
from rpod_pose.navigation.pose_measurement import MOUNT, calibration_of
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.integrity import IntegrityConfig

COMPONENTS = ("x_m", "y_m", "z_m", "about_x_deg", "about_y_deg", "about_z_deg")
"""Components of an offset and their units, chaser axes."""
_UNITS = np.repeat([1.0, np.rad2deg(1.0)], 3)
"""Units of the components over those of the filter's errors: m, and deg for rad. Physics: a conversion of
units."""


@dataclass(frozen=True, eq=False)
class MountOffset:
    """Error of one sensor's stated mount less that of another, chaser axes."""

    one: str
    """Sensor whose mount is the reference."""
    other: str
    error: FloatArray
    """(dp, dtheta), m and rad, shape (6,)."""
    covariance: FloatArray
    """Covariance of it, shape (6, 6)."""
    biased: tuple[str, ...] = ()
    """Those of the two sensors whose distances may be wrong by a bias that lasts."""

    @property
    def evidence(self) -> dict[str, float]:
        """The offset and its standard deviations, by component."""
        name = f"mount_of_{self.other}_from_{self.one}"
        sigma = np.sqrt(np.diag(self.covariance))
        found = {f"{name}_{what}": float(v) for what, v in zip(COMPONENTS, _UNITS * self.error, strict=True)}
        sigmas = zip(COMPONENTS, _UNITS * sigma, strict=True)
        return found | {f"{name}_sigma_{what}": float(v) for what, v in sigmas}

    def excess(self, config: IntegrityConfig) -> float:
        """Return chi-squared of the offset if both mounts were as good as they are declared."""
        declared = np.repeat([config.mount_sigma_m, np.deg2rad(config.mount_sigma_deg)], 3)
        expected = self.covariance + 2.0 * np.diag(declared**2)
        return float(self.error @ np.linalg.solve(expected, self.error))

    def describe(self) -> str:
        """Return the offset in words, with its figures."""
        angle_deg, length_m = np.rad2deg(np.linalg.norm(self.error[3:])), np.linalg.norm(self.error[:3])
        sigma = np.sqrt(np.diag(self.covariance))
        sigma_deg, sigma_m = np.rad2deg(sigma[3:].max()), sigma[:3].max()
        of_both = " and ".join(self.biased)
        bias = f", with the bias of the distances of {of_both}, of which it cannot be told" if of_both else ""
        return (
            f"the mounts of {self.one} and {self.other} disagree by {angle_deg:.2f} deg "
            f"(sigma {sigma_deg:.2f}) and {1e3 * length_m:.0f} mm (sigma {1e3 * sigma_m:.0f}){bias}"
        )


def mount_offsets(state: FilterState, sensors: Iterable[str]) -> list[MountOffset]:
    """Return the offsets between the mounts of sensors that have measured the target, pair by pair."""
    places, values = state.places(), {block.name: block.value for block in state.blocks}
    known = [name for name in sorted(sensors) if MOUNT.format(name) in places]
    found = []
    for one, other in combinations(known, 2):
        difference = np.zeros((6, state.size))
        difference[:, places[MOUNT.format(other)]] = np.eye(6)
        difference[:, places[MOUNT.format(one)]] = -np.eye(6)
        error = values[MOUNT.format(other)] - values[MOUNT.format(one)]
        biased = tuple(name for name in (one, other) if calibration_of(name) in places)
        found.append(MountOffset(one, other, error, difference @ state.covariance @ difference.T, biased))
    return found
