"""Errors of the published truth, as of robots or of motion capture, and their covariance."""

from math import exp, radians, sqrt

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.motion import TruthErrorConfig
from rpod_schemas.poses import pose_of, rotation_matrix

_STREAM = 0x7472757468
"""Number that separates these errors from other noise of the same seed: "truth" in ASCII."""


class TruthError:
    """Perturbs true poses, one after the other, by a stationary Gauss-Markov process."""

    def __init__(self, config: TruthErrorConfig, *, seed: int, rate_hz: float) -> None:
        sigma = np.repeat([config.sigma_position_m, radians(config.sigma_attitude_deg)], 3)
        self.covariance: FloatArray = np.diag(sigma**2)
        """Covariance of (dp, dtheta) in chaser axes (ICD section 1), shape (6, 6)."""
        self._kept = exp(-1.0 / (rate_hz * config.correlation_s)) if config.correlation_s else 0.0
        self._sigma = sigma
        self._generator = np.random.default_rng((seed, _STREAM))
        self._error: FloatArray = sigma * self._generator.standard_normal(6)

    def perturb(self, pose: RigidTransform) -> RigidTransform:
        """Return the next pose with its error."""
        turned = Rotation.from_rotvec(self._error[3:]).as_matrix() @ rotation_matrix(pose)
        perturbed = pose_of(turned, pose.translation + self._error[:3])
        new = self._sigma * self._generator.standard_normal(6)
        self._error = self._kept * self._error + sqrt(1.0 - self._kept**2) * new
        return perturbed
