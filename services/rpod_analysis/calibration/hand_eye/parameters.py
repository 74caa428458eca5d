"""Parameters of a hand-eye calibration: their indices, their values, and the result of a fit."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from rpod_analysis.calibration.hand_eye.start import Motion
from rpod_schemas.arrays import FloatArray

MOUNT_M, MOUNT_RAD, HOLDER_M, HOLDER_RAD = (slice(start, start + 3) for start in (0, 3, 6, 9))
MOUNT, HOLDER = slice(0, 6), slice(6, 12)
OFFSET, DRIFT, DEPTH = 12, 13, 14
"""Indices of the parameters: m and rad of mount (chaser axes) and holder (holder axes), then s, s/s and m."""
PARAMETERS = 15


@dataclass(frozen=True, eq=False)
class Assumptions:
    """Prior knowledge of a fit."""

    depth_sigma_m: float = 0.0
    """Standard deviation of the offset of the sensor's distances, m; 0 for distances without an offset."""
    drift_sigma: float = 1e-4
    """Standard deviation of the clock's drift, s/s: quartz oscillators are within 100 ppm."""
    mount: tuple[FloatArray, FloatArray] | None = None
    """Mount that is kept: rotation matrix, shape (3, 3), and position, shape (3,), m; None if it is found."""


@dataclass(frozen=True, eq=False)
class State:
    """Values of the parameters: mount X, holder Y, clock and depth offset."""

    R_X: FloatArray
    """Attitude of the mount, R_chaser_sensor, shape (3, 3)."""
    t_X: FloatArray
    """Position of the mount, chaser axes, shape (3,), m."""
    R_Y: FloatArray
    """Attitude of the target in the holder, R_holder_target, shape (3, 3)."""
    t_Y: FloatArray
    """Position of the target in the holder, holder axes, shape (3,), m."""
    offset_s: float
    """Length by which the sensor's clock is ahead in the middle of the poses, s."""
    drift: float = 0.0
    """Rate at which this length grows, s/s."""
    depth_m: float = 0.0
    """Measured minus true distance along the line of sight, m."""

    def moved(self, step: FloatArray) -> "State":
        """Return the values after a step; turns are about the axes of chaser and holder."""
        return State(
            Rotation.from_rotvec(step[MOUNT_RAD]).as_matrix() @ self.R_X,
            self.t_X + step[MOUNT_M],
            Rotation.from_rotvec(step[HOLDER_RAD]).as_matrix() @ self.R_Y,
            self.t_Y + step[HOLDER_M],
            self.offset_s + step[OFFSET],
            self.drift + step[DRIFT],
            self.depth_m + step[DEPTH],
        )


@dataclass(frozen=True, eq=False)
class HandEye:
    """Result of a fit."""

    state: State
    """Values of the parameters."""
    middle_ns: int
    """Stamp of the sensor in the middle of the poses, at which the offset is given."""
    covariance: FloatArray
    """Covariance of all parameters, by the indices above, shape (15, 15); zero for those that were kept."""
    independent: FloatArray
    """Covariance if errors were independent and of the residuals' own size: the Cramer-Rao bound of normal
    ones, shape (15, 15)."""
    motion: Motion
    pairs: int
    """Number of pairs of poses."""
    unused: int
    """Number of poses of the sensor without truth around them."""
    outliers: int
    """Number of pairs that are outliers and do not count."""
    scale: float
    """Robust size of the residuals in standard deviations of sensor and truth; 1 if these are right."""
    block_correlation: float
    """Correlation of successive blocks of residuals; if it is far above 0, the covariance is too small."""
    residual_m: float
    """RMS of the positions' residuals of the pairs that count, m."""
    residual_rad: float
    """RMS of the attitudes' residuals of the pairs that count, rad."""
    speed_m_s: float
    """RMS speed of the holder in the chaser, m/s."""
    rate_rad_s: float
    """RMS rate of its rotation, rad/s."""

    @property
    def offset_sigma_s(self) -> float:
        """Standard deviation of the clock's offset in the middle of the poses, s."""
        return self.sigma(OFFSET)

    @property
    def drift_sigma(self) -> float:
        """Standard deviation of the clock's drift, s/s."""
        return self.sigma(DRIFT)

    def sigma(self, place: int) -> float:
        """Return the standard deviation of a parameter."""
        return float(np.sqrt(self.covariance[place, place]))

    def worst(self, places: slice) -> tuple[float, FloatArray]:
        """Return the largest standard deviation of a vector, and its direction, shape (3,)."""
        values, vectors = np.linalg.eigh(self.covariance[places, places])
        return float(np.sqrt(values[-1].clip(0.0))), vectors[:, -1]

    @property
    def depth_correlation(self) -> float:
        """Correlation of the depth offset with the mount along the boresight; 0 if either is kept."""
        variance = self._along(self.covariance) * self.covariance[DEPTH, DEPTH]
        shared = float(self.state.R_X[:, 2] @ self.covariance[MOUNT_M, DEPTH])
        return shared / np.sqrt(variance) if variance > 0.0 else 0.0

    @property
    def boresight_sigma_m(self) -> float:
        """Standard deviation of the mount along the boresight if the depth offset were known exactly, m."""
        share = 1.0 - self.depth_correlation**2
        return float(np.sqrt(max(share * self._along(self.covariance), 0.0)))

    def _along(self, covariance: FloatArray) -> float:
        along = self.state.R_X[:, 2]
        return float(along @ covariance[MOUNT_M, MOUNT_M] @ along)
