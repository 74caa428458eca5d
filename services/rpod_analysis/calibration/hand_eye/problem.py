"""Residuals of a hand-eye calibration, with their derivatives and covariances."""

import numpy as np
from scipy.spatial.transform import Rotation

from rpod_analysis.calibration.hand_eye.parameters import (
    DEPTH,
    DRIFT,
    HOLDER_M,
    HOLDER_RAD,
    MOUNT_M,
    MOUNT_RAD,
    OFFSET,
    PARAMETERS,
    Assumptions,
    State,
)
from rpod_analysis.calibration.hand_eye.poses import Interpolated, StampedPoses
from rpod_schemas.arrays import FloatArray

TWIST_S = 0.1
"""Half the time over which the truth's twist is taken."""


class Problem:
    """Pairs of poses: their residuals in chaser axes, and the derivatives and covariances of these.

    The truth is taken at one offset of the clock and moved from there by its twist over some tenths of a
    second. The slope between two neighbours would be dominated by noise: at 250 Hz, 1.56 mm give 0.5 m/s.
    """

    def __init__(self, measured: StampedPoses, truth: Interpolated, known: Assumptions) -> None:
        self.measured, self.known = measured, known
        self._truth = truth
        self.middle_ns = int((measured.stamp_ns[0] + measured.stamp_ns[-1]) // 2)
        self._from_middle_s = 1e-9 * (measured.stamp_ns - self.middle_ns)
        self._sight = measured.t_m / np.linalg.norm(measured.t_m, axis=1, keepdims=True)
        self.free = np.ones(PARAMETERS, bool)
        self.free[MOUNT_M] = self.free[MOUNT_RAD] = known.mount is None
        self.free[DEPTH] = known.depth_sigma_m > 0.0
        self.free[DRIFT] = known.drift_sigma > 0.0
        self.prior_information = np.zeros(PARAMETERS)
        self.prior_information[DRIFT] = known.drift_sigma**-2 if self.free[DRIFT] else 0.0
        self.prior_information[DEPTH] = known.depth_sigma_m**-2 if self.free[DEPTH] else 0.0

    def take_truth(self, state: State) -> None:
        """Take the truth at the offset and drift of the values."""
        self._taken_s = self._later_s(state)
        stamp_ns = self.measured.stamp_ns
        self.R_B, self.t_B = self._truth.at(stamp_ns, self._taken_s)
        (R_before, t_before), (R_after, t_after) = (
            self._truth.at(stamp_ns, self._taken_s + shift_s) for shift_s in (-TWIST_S, TWIST_S)
        )
        turn = _rotvec(R_after @ _transposed(R_before))
        self.v_m_s, self.w_rad_s = (t_after - t_before) / (2.0 * TWIST_S), turn / (2.0 * TWIST_S)
        self._truth_covariance = self._truth.covariance_at(stamp_ns, self._taken_s)

    def _later_s(self, state: State) -> FloatArray:
        return -(state.offset_s + state.drift * self._from_middle_s).astype(np.float64)

    def residuals(self, state: State) -> FloatArray:
        """Return (dp, dtheta) of the measured pose against the true one, chaser axes, shape (N, 6)."""
        moved_s = (self._later_s(state) - self._taken_s)[:, None]
        R_B = Rotation.from_rotvec(moved_s * self.w_rad_s).as_matrix() @ self.R_B
        t_S = self.measured.t_m - state.depth_m * self._sight
        true_m = R_B @ state.t_Y + self.t_B + moved_s * self.v_m_s
        turn = (state.R_X @ self.measured.R) @ _transposed(R_B @ state.R_Y)
        return np.hstack([t_S @ state.R_X.T + state.t_X - true_m, _rotvec(turn)])

    def jacobian(self, state: State) -> FloatArray:
        """Return the derivatives of the residuals by all parameters, for small residuals, (N, 6, 15)."""
        arm_m = self.R_B @ state.t_Y
        sight = self._sight @ state.R_X.T
        derivatives = np.zeros((len(self.measured), 6, PARAMETERS))
        derivatives[:, :3, MOUNT_M] = derivatives[:, 3:, MOUNT_RAD] = np.eye(3)
        derivatives[:, :3, MOUNT_RAD] = -_crossed(self.measured.t_m @ state.R_X.T)
        derivatives[:, :3, HOLDER_M] = derivatives[:, 3:, HOLDER_RAD] = -self.R_B
        derivatives[:, :3, OFFSET] = self.v_m_s + np.cross(self.w_rad_s, arm_m)
        derivatives[:, 3:, OFFSET] = self.w_rad_s
        derivatives[:, :, DRIFT] = derivatives[:, :, OFFSET] * self._from_middle_s[:, None]
        derivatives[:, :3, DEPTH] = -sight
        return derivatives

    def covariance(self, state: State) -> FloatArray:
        """Return the covariances of the residuals, of sensor and truth together, shape (N, 6, 6)."""
        turn = np.zeros((6, 6))
        turn[:3, :3] = turn[3:, 3:] = state.R_X
        carried = np.tile(np.eye(6), (len(self.measured), 1, 1))
        carried[:, :3, 3:] = -_crossed(self.R_B @ state.t_Y)
        truth = carried @ self._truth_covariance @ _transposed(carried)
        whole: FloatArray = turn @ self.measured.covariance @ turn.T + truth
        return whole


def _rotvec(R: FloatArray) -> FloatArray:
    return Rotation.from_matrix(R, assume_valid=True).as_rotvec()


def _transposed(matrices: FloatArray) -> FloatArray:
    return np.swapaxes(matrices, 1, 2)


def _crossed(vectors: FloatArray) -> FloatArray:
    """Return the matrices [v x] of vectors, shape (N, 3, 3): row k is e_k x v."""
    return np.cross(np.eye(3), vectors[:, None])
