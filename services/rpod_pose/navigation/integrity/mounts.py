"""Offsets between the mounts of two sensors, as the filter estimates them.

The error of each sensor's mount is a state of the filter. Only the difference of two such errors is
observable: it shows by how much two sensors disagree, but not which of them is wrong. Along the line of
sight, a wrong position of a mount has the same effect as ranges that are all too long. The offset contains
both.

A bias of the ranges is considered by the filter, and not estimated. So the filter gives the mount the share
of their sum that its prior has, P / (P + B + r), with the priors P of the mounts and B of the bias, and the
variance r of what the frames tell of the sum. The sum itself follows from this share, which the filter's own
covariance shows: the mount has lost P times the share of its prior.
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


@dataclass(frozen=True)
class Longer:
    """By how much one sensor's distances are longer than another's, by mounts and bias together, m."""

    length_m: float
    sigma_m: float


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
    longer: Longer | None = None
    """How much longer the distances of ``other`` are; None where no bias hides this, or nothing is known."""

    @property
    def evidence(self) -> dict[str, float]:
        """The offset and its standard deviations, by component."""
        name = f"mount_of_{self.other}_from_{self.one}"
        sigma = np.sqrt(np.diag(self.covariance))
        found = {f"{name}_{what}": float(v) for what, v in zip(COMPONENTS, _UNITS * self.error, strict=True)}
        sigmas = zip(COMPONENTS, _UNITS * sigma, strict=True)
        found |= {f"{name}_sigma_{what}": float(v) for what, v in sigmas}
        if self.longer is not None:
            longer = f"distances_of_{self.other}_longer_than_of_{self.one}"
            found |= {f"{longer}_m": self.longer.length_m, f"{longer}_sigma_m": self.longer.sigma_m}
        return found

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
        if self.longer is not None:
            length_mm, sigma_mm = 1e3 * self.longer.length_m, 1e3 * self.longer.sigma_m
            bias += (
                f": together they make those of {self.other} {length_mm:.0f} mm longer (sigma {sigma_mm:.0f})"
            )
        return (
            f"the mounts of {self.one} and {self.other} disagree by {angle_deg:.2f} deg "
            f"(sigma {sigma_deg:.2f}) and {1e3 * length_m:.0f} mm (sigma {1e3 * sigma_m:.0f}){bias}"
        )


def mount_offsets(
    state: FilterState, sensors: Iterable[str], mount_sigma_m: float = 0.0
) -> list[MountOffset]:
    """Return the offsets between the mounts of sensors that have measured the target, pair by pair.

    Args:
        state: state of the filter.
        sensors: names of the sensors.
        mount_sigma_m: prior standard deviation of the place of each mount, along each axis; with it a bias of
            the distances is reported together with the mounts.
    """
    places, values = state.places(), {block.name: block.value for block in state.blocks}
    known = [name for name in sorted(sensors) if MOUNT.format(name) in places]
    found = []
    for one, other in combinations(known, 2):
        difference = np.zeros((6, state.size))
        difference[:, places[MOUNT.format(other)]] = np.eye(6)
        difference[:, places[MOUNT.format(one)]] = -np.eye(6)
        error = values[MOUNT.format(other)] - values[MOUNT.format(one)]
        biased = tuple(name for name in (one, other) if calibration_of(name) in places)
        covariance = difference @ state.covariance @ difference.T
        together = [difference[:3] @ state.covariance[:, places[calibration_of(name)]] for name in biased]
        longer = None
        if together:
            longer = _longer(error[:3], covariance[:3, :3], np.hstack(together), state, mount_sigma_m)
        found.append(MountOffset(one, other, error, covariance, biased, longer))
    return found


def _longer(
    error_m: FloatArray,
    covariance: FloatArray,
    together: FloatArray,
    state: FilterState,
    mount_sigma_m: float,
) -> Longer | None:
    """Return how much longer the distances of one sensor are, by mounts and bias together.

    Args:
        error_m: the offset of the mounts, shape (3,).
        covariance: covariance of it, shape (3, 3).
        together: its covariance with the errors of calibration, whose priors are of unit variance, shape
            (3, N). It shows the direction in which mounts and bias cannot be told apart.
        state: state of the filter.
        mount_sigma_m: prior standard deviation of the place of each mount.
    """
    left, common, _ = np.linalg.svd(together, full_matrices=False)
    along = left[:, 0] if left[:, 0] @ state.T_chaser_target.translation > 0.0 else -left[:, 0]
    prior = 2.0 * mount_sigma_m**2
    lost = prior - float(along @ covariance @ along)
    if not (prior > 0.0 and 0.0 < lost <= prior):
        return None
    share = lost / prior
    told = prior / share - prior - (float(common[0]) / share) ** 2
    return Longer(float(along @ error_m) / share, float(np.sqrt(max(told, 0.0))))
