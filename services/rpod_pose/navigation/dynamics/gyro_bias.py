"""Estimation of the gyro's bias from the star tracker: a Kalman filter of the chaser's own attitude.

The errors are estimate minus truth: phi of the attitude A in axes at rest, A_est = Exp(phi) A, and d of the
bias. With rates that are corrected by the estimated bias, dphi/dt = -A d. A measured attitude with white
noise observes phi, and a sequence of them observes d (E. J. Lefferts, F. L. Markley, M. D. Shuster, Kalman
Filtering for Spacecraft Attitude Estimation, J. Guidance 5 (1982) 417-429, in axes at rest).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from rpod_pose.navigation.filter.rotations import exponential
from rpod_schemas.arrays import FloatArray

_PHI, _BIAS = slice(0, 3), slice(3, 6)
"""Components of the error vector (phi, d)."""


@dataclass(frozen=True, eq=False, slots=True)
class GyroBias:
    """Estimate of the bias at one time."""

    bias_rad_s: FloatArray
    """Estimated bias, chaser axes, shape (3,)."""
    covariance: FloatArray
    """Covariance of (phi, d), shape (6, 6)."""
    K: FloatArray | None = None
    """Rotation matrix from the axes in which rates are integrated to the axes at rest of the star tracker,
    shape (3, 3); None before the first attitude."""

    @classmethod
    def unknown(cls, sigma_rad_s: float) -> "GyroBias":
        """Return a bias of which only the standard deviation is known."""
        return cls(np.zeros(3), np.diag(np.repeat([0.0, sigma_rad_s**2], 3)))

    @property
    def variance(self) -> float:
        """Mean variance of the bias about the three axes, (rad/s)^2."""
        return float(self.covariance[_BIAS, _BIAS].trace() / 3.0)

    def after(
        self, turned: FloatArray, *, step_s: float, noise_rad2_s: float, walk_rad2_s3: float
    ) -> "GyroBias":
        """Return the estimate after a step.

        Args:
            turned: time integral of the attitude from integrated rates over the step, s, shape (3, 3).
            step_s: time, s.
            noise_rad2_s: square of the gyro's angular random walk.
            walk_rad2_s3: density of the random walk of the bias.
        """
        if self.K is None:
            return self
        F = np.eye(6)
        F[_PHI, _BIAS] = -self.K @ turned
        covariance = F @ self.covariance @ F.T
        covariance[range(6), range(6)] += step_s * np.repeat([noise_rad2_s, walk_rad2_s3], 3)
        return replace(self, covariance=covariance)

    def corrected(self, measured: FloatArray, G: FloatArray, variance: float) -> "GyroBias":
        """Return the estimate after a measured attitude.

        Args:
            measured: attitude in axes at rest, shape (3, 3).
            G: the attitude from integrated rates, in the axes of the integration, shape (3, 3).
            variance: variance of the measured attitude about each axis, rad2.
        """
        if self.K is None:
            covariance = self.covariance.copy()
            covariance[_PHI, _PHI] = variance * np.eye(3)
            return GyroBias(self.bias_rad_s, covariance, measured @ G.T)
        off = Rotation.from_matrix(measured @ (self.K @ G).T, assume_valid=True).as_rotvec()
        P = self.covariance
        S = P[_PHI, _PHI] + variance * np.eye(3)
        gain = np.linalg.solve(S, P[_PHI]).T
        correction = gain @ off
        keep = np.eye(6)
        keep[:, _PHI] -= gain
        return GyroBias(
            self.bias_rad_s + correction[_BIAS],
            keep @ P @ keep.T + variance * gain @ gain.T,
            exponential(correction[_PHI]) @ self.K,
        )
