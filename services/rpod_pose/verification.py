"""Whether a registration is believed: cost, inliers and self-check against their limits.

A stream of registrations has a record besides: how many of them the frames contradicted.

f_MAX is the 2015 paper's failure detection (section 4.5); alone it accepts wrong poses on sparse
scans, so the share of rays or pixels on which model and measurement agree is asked as well.
"""

import math
from dataclasses import dataclass

import numpy as np

from rpod_pose.ports import Registration
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.verification import VerificationConfig

MEMORY, BENEFIT = 90.0, 20.0
"""Frames that a record remembers, and that it takes for granted to have agreed before the first."""


@dataclass(frozen=True)
class Record:
    """How often a sensor's frames contradicted the pose that was tracked, the older ones forgotten by and by.

    A single frame of something else may look like the target by chance, or by the side that it shows; a
    stream of them does so for a while only.
    """

    frames: float = 0.0
    """That say something."""
    contrary: float = 0.0
    """Those of them that speak against the pose."""

    @property
    def share(self) -> float:
        """Of the frames, those that speak against the pose."""
        return self.contrary / (self.frames + BENEFIT)

    def after(self, registration: Registration) -> "Record":
        """Return the record with one more frame; one that shows nothing says nothing."""
        if registration.T_sensor_target is None:
            return self
        kept = 1.0 - 1.0 / MEMORY
        return Record(kept * self.frames + 1.0, kept * self.contrary + registration.contradicted)


def doubt(registration: Registration, limits: VerificationConfig) -> str:
    """Return why a registration is not believed, in words for the operator; empty if it is.

    What a method does not know, inlier share and explained share, is not asked; nor is anything of a method
    that judges its results by itself, but for what the measurement leaves open.
    """
    if registration.reason or registration.T_sensor_target is None:
        return registration.reason or "no pose"
    if (left_open := _left_open(registration.covariance, limits)) or registration.judged:
        return left_open
    cost, inliers = registration.cost_m2, registration.inliers
    share, explained = registration.inlier_share, registration.explained_share
    demands = (
        (cost <= limits.max_cost_m2, f"cost {cost:.2g} m2 above {limits.max_cost_m2:.2g}"),
        (inliers >= limits.min_inliers, f"{inliers} inliers, needs {limits.min_inliers}"),
        (
            math.isnan(share) or share >= limits.min_inlier_share,
            f"inlier share {share:.2f} below {limits.min_inlier_share:.2f}",
        ),
        (
            math.isnan(explained) or explained >= limits.min_explained_share,
            f"explained share {explained:.2f} below {limits.min_explained_share:.2f}",
        ),
        (np.isfinite(registration.covariance).all(), "no covariance"),
    )
    return next((reason for met, reason in demands if not met), "")


def _left_open(covariance: FloatArray, limits: VerificationConfig) -> str:
    """Return what of the pose the measurement does not determine; empty where that is not asked."""
    for name, block, most, unit in (
        ("position", covariance[:3, :3], limits.max_sigma_m, "m"),
        ("attitude", np.rad2deg(np.rad2deg(covariance[3:, 3:])), limits.max_sigma_deg, "deg"),
    ):
        if most is not None and not (sigma := _worst_sigma(block)) <= most:
            return f"the {name} is left open: sigma {sigma:.2g} {unit}, {most:g} at most"
    return ""


def _worst_sigma(covariance: FloatArray) -> float:
    """Return the standard deviation in the worst direction; NaN where it is unknown."""
    if not np.isfinite(covariance).all():
        return math.nan
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))
