"""Mount of a sensor, as ``rpod calibrate mount`` finds it; drivers and the estimator take its file."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field
from scipy.spatial.transform import RigidTransform

from rpod_schemas.arrays import Matrix6
from rpod_schemas.bounds import MOUNT_M
from rpod_schemas.config.base import Config, Count, Finite, NonNegative, in_place, load, write
from rpod_schemas.poses import Pose, make_pose


class MountEvidence(Config):
    """Data from which a mount was derived; they are not needed to apply it."""

    log: str
    """Name of the log."""
    sensor: str
    """Name of the sensor."""
    covariance: Matrix6
    """Covariance of (dp, dtheta) of the mount in chaser axes (ICD section 1): m2, m rad, rad2."""
    T_holder_target: Pose = Field(default_factory=make_pose)
    """Transform from the body whose pose the truth gives to the target, found with the mount."""
    holder_covariance: Matrix6 = Field(default_factory=lambda: np.zeros((6, 6)))
    """Its covariance, in the holder's axes."""
    depth_offset_m: Finite = 0.0
    """Offset of the sensor's distances that was found with the mount, m; it is not part of the mount."""
    depth_offset_sigma_m: NonNegative = 0.0
    """Its standard deviation, m."""
    depth_correlation: Annotated[float, Field(ge=-1, le=1)] = 0.0
    """Correlation of this offset with the mount's position along the boresight."""
    pairs: Count
    """Number of pairs of poses of sensor and truth."""
    residual_m: NonNegative
    """RMS of the positions' residuals, m."""
    residual_deg: NonNegative
    """RMS of the attitudes' residuals, deg."""


class MountCalibration(Config):
    """Content of a mount's file."""

    T_chaser_sensor: Pose
    """Mount: pose of the sensor's (optical) frame in the chaser."""
    evidence: MountEvidence | None = None
    """Data from which it was derived."""

    def write(self, path: Path) -> Path:
        """Write the file as JSON or YAML, by its suffix, and return its path."""
        return write(self, path)


def _read(value: Any) -> Any:
    return in_place(value, lambda path: load(MountCalibration, path).T_chaser_sensor)


def _near(pose: RigidTransform) -> RigidTransform:
    _REACH_M.check(math.hypot(*pose.translation))  # of numbers beyond 1e154, too
    return pose


_REACH_M = replace(MOUNT_M, remedy="translation_m is in metres")
MountPose = Annotated[Pose, AfterValidator(_near)]
"""A mount, written inline."""
Mount = Annotated[MountPose, BeforeValidator(_read)]
"""A mount, written inline or as the path of a file of ``rpod calibrate mount``."""
