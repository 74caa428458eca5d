"""Mount, holder, clock and depth offset of a sensor in one robust fit, with their covariance.

X S_i = B(stamp_i - offset_i) Y, where S_i = T_sensor_target is measured, B = T_chaser_holder is the truth
over time, X = T_chaser_sensor is the mount and Y = T_holder_target the holder. Sensor and truth have
covariances; a residual is weighted by their sum. Pairs with large residuals count less (Tukey's biweight of
the Mahalanobis distance). Successive errors are correlated, so the covariance of the result is a jackknife
over blocks of time (Kuensch, Annals of Statistics 17(3), 1989), which needs no model of them. It is never
below that of independent errors.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from rpod_analysis.calibration.hand_eye.poses import Interpolated, StampedPoses
from rpod_analysis.calibration.hand_eye.start import (
    NO_MOTION,
    Motion,
    holder_of,
    mount_of,
    offset_by_rates,
    relative_motions,
)
from rpod_analysis.errors import CalibrationError
from rpod_schemas.arrays import FloatArray

MOUNT_M, MOUNT_RAD, HOLDER_M, HOLDER_RAD = (slice(start, start + 3) for start in (0, 3, 6, 9))
MOUNT, HOLDER = slice(0, 6), slice(6, 12)
OFFSET, DRIFT, DEPTH = 12, 13, 14
"""Places of the parameters: m and rad of mount (chaser axes) and holder (holder axes), then s, s/s and m."""
PARAMETERS = 15
_BLOCKS = 15
"""Number of blocks of the jackknife: 4 s of a minute, longer than errors of a pose stay the same."""
_ROUNDS = 20
_TWIST_S = 0.1
"""Half the time over which the truth's twist is taken."""
_TUKEY = 7.0
"""Mahalanobis distance beyond which a pair does not count, in robust standard deviations: 97 % efficient for
normal errors in six dimensions."""
_MEDIAN_OF_6 = 5.348
"""Median of chi-squared with six degrees of freedom."""
_SETTLED = 1e-7
"""Greatest step of a parameter, m, rad or s, at which the fit has converged."""
_CROSSED = (0, 1, 2, -1.0), (0, 2, 1, 1.0), (1, 0, 2, 1.0), (1, 2, 0, -1.0), (2, 0, 1, -1.0), (2, 1, 0, 1.0)
_LEAST_PAIRS = 30
_MOST_GAP = 2.5
"""Longest gap in the truth in which it is interpolated, in its usual intervals."""


@dataclass(frozen=True, eq=False)
class Assumptions:
    """What is known before the fit."""

    depth_sigma_m: float = 0.0
    """Standard deviation of the offset of the sensor's distances, m; 0 for distances without an offset."""
    drift_sigma: float = 1e-4
    """Standard deviation of the clock's drift, s/s: quartz oscillators are within 100 ppm."""
    mount: tuple[FloatArray, FloatArray] | None = None
    """Mount that is kept, rotation matrix and position; None if it is found."""


@dataclass(frozen=True, eq=False)
class State:
    """Values of the parameters: mount X, holder Y, clock and depth offset."""

    R_X: FloatArray
    t_X: FloatArray
    R_Y: FloatArray
    t_Y: FloatArray
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
    """Covariance of all 15 parameters, see the places above; zero for those that were kept."""
    independent: FloatArray
    """Covariance if errors were independent and of the residuals' own size: the Cramer-Rao bound of normal
    ones, shape (15, 15)."""
    motion: Motion
    pairs: int
    """Number of pairs of poses."""
    unused: int
    """Number of poses of the sensor without truth around them."""
    outliers: int
    """Number of pairs that do not count."""
    scale: float
    """Robust size of the residuals in standard deviations of sensor and truth; 1 if these are right."""
    block_correlation: float
    """Correlation of successive blocks of residuals; far above 0, the covariance is too small."""
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


class _Problem:
    """Pairs of poses: their residuals in chaser axes, and the derivatives and covariances of these.

    The truth is taken at one offset of the clock and moved from there by its twist over some tenths of a
    second. The slope between two neighbours would be their noise: of 1.56 mm it is 0.5 m/s at 250 Hz.
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
            self._truth.at(stamp_ns, self._taken_s + shift_s) for shift_s in (-_TWIST_S, _TWIST_S)
        )
        turn = _rotvec(R_after @ _transposed(R_before))
        self.v_m_s, self.w_rad_s = (t_after - t_before) / (2.0 * _TWIST_S), turn / (2.0 * _TWIST_S)
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


def fit_hand_eye(measured: StampedPoses, truth: StampedPoses, known: Assumptions | None = None) -> HandEye:
    """Return mount, holder, clock and depth offset that explain a sensor's poses by the truth.

    Args:
        measured: poses T_sensor_target with the sensor's stamps.
        truth: poses T_chaser_holder with those of the truth.
        known: prior knowledge.

    Raises:
        CalibrationError: the poses are too few, or the motion does not tell the mount; the text says which
            motion is missing.
    """
    known = known or Assumptions()
    measured, truth = measured.in_order(), truth.in_order()
    if min(len(measured), len(truth)) < _LEAST_PAIRS:
        raise CalibrationError(
            f"{len(measured)} poses of the sensor and {len(truth)} of the truth, needs {_LEAST_PAIRS} of each"
        )
    by_rates_s = offset_by_rates(measured, truth)
    far = by_rates_s is not None and abs(by_rates_s) > _TWIST_S
    offsets_s = (0.0, by_rates_s) if far and by_rates_s is not None else (0.0,)
    tries = [_fit_from(measured, truth, known, offset_s) for offset_s in offsets_s]
    found = [result for result in tries if isinstance(result, HandEye)]
    if not found:
        raise next(result for result in tries if isinstance(result, CalibrationError))
    return min(found, key=lambda result: (result.outliers > 0.5 * result.pairs, result.scale))


def _fit_from(
    measured: StampedPoses, truth: StampedPoses, known: Assumptions, offset_s: float
) -> HandEye | CalibrationError:
    try:
        found = _fit_pairs(measured, truth, known, offset_s)
        if abs(found.state.offset_s - offset_s) > _TWIST_S:  # other pairs have truth around them
            found = _fit_pairs(measured, truth, known, found.state.offset_s)
        return found
    except CalibrationError as error:
        return error


def _fit_pairs(measured: StampedPoses, truth: StampedPoses, known: Assumptions, offset_s: float) -> HandEye:
    usual_s = 1e-9 * float(np.median(np.diff(truth.stamp_ns)))
    gaps_s = [truth.gap_s(measured.stamp_ns, -offset_s + shift_s) for shift_s in (-_TWIST_S, 0.0, _TWIST_S)]
    kept = np.max(gaps_s, axis=0) <= _MOST_GAP * usual_s
    if kept.sum() < _LEAST_PAIRS:
        raise CalibrationError(
            f"{int(kept.sum())} poses of the sensor have truth around them, needs {_LEAST_PAIRS}; the first "
            f"stamp is {1e-9 * float(measured.stamp_ns[0] - truth.stamp_ns[0]):.3f} s after the truth's first"
        )
    problem = _Problem(measured.at(kept), Interpolated(truth), known)
    state, motion = _start(problem, offset_s)
    return replace(_solve(problem, state), motion=motion, unused=int((~kept).sum()))


def _start(problem: _Problem, offset_s: float) -> tuple[State, Motion]:
    zero = np.zeros(3)
    problem.take_truth(State(np.eye(3), zero, np.eye(3), zero, offset_s))
    seen, there = (problem.measured.R, problem.measured.t_m), (problem.R_B, problem.t_B)
    A, C, motion = relative_motions(seen, there)
    mount = problem.known.mount
    if mount is None:
        if not motion.turns_about_two_axes:
            raise CalibrationError(motion.missing())
        mount = mount_of(A, C)
    return State(*mount, *holder_of(mount, seen, there), offset_s), motion


def _solve(problem: _Problem, state: State) -> HandEye:
    weights, scale = np.ones(len(problem.measured)), 1.0
    problem.take_truth(state)
    for _ in range(_ROUNDS):
        whitening = _whitening(problem, state)
        step = _step(problem, state, np.sqrt(weights)[:, None, None] * whitening)
        state = state.moved(step)
        problem.take_truth(state)
        distance = np.linalg.norm(_applied(whitening, problem.residuals(state)), axis=1)
        scale = float(np.sqrt(np.median(distance**2) / _MEDIAN_OF_6))
        before, weights = weights, np.maximum(1.0 - (distance / (_TUKEY * scale)) ** 2, 0.0) ** 2
        if np.abs(weights - before).max() < 1e-3 and np.abs(step).max() < _SETTLED:
            break
    return _result(problem, state, _whitening(problem, state), weights, scale)


def _step(problem: _Problem, state: State, whitening: FloatArray) -> FloatArray:
    """Return the step to the least-squares solution with the present weights."""
    free = problem.free
    root = np.sqrt(problem.prior_information)

    def cost(step: FloatArray) -> FloatArray:
        moved = state.moved(_whole(step, free))
        known = root[[DRIFT, DEPTH]] * [moved.drift, moved.depth_m]
        return np.append(_applied(whitening, problem.residuals(moved)), known)

    def slope(step: FloatArray) -> FloatArray:
        moved = state.moved(_whole(step, free))
        rows = whitening @ problem.jacobian(moved)
        return np.vstack([rows.reshape(-1, PARAMETERS), np.diag(root)[[DRIFT, DEPTH]]])[:, free]

    solved = least_squares(cost, np.zeros(int(free.sum())), jac=slope, x_scale="jac", method="lm")
    return _whole(solved.x, free)


def _whole(step: FloatArray, free: FloatArray) -> FloatArray:
    whole = np.zeros(PARAMETERS)
    np.place(whole, free, step)
    return whole


def _whitening(problem: _Problem, state: State) -> FloatArray:
    """Return W with W C W^T = 1 for each pair's covariance C, shape (N, 6, 6).

    Where the covariances are not known, the spread of the residuals stands for them.
    """
    covariance = problem.covariance(state)
    if not (np.diagonal(covariance, axis1=1, axis2=2) > 0.0).all():
        residuals = np.abs(problem.residuals(state))
        spread = [1.4826 * float(np.median(part)) for part in (residuals[:, :3], residuals[:, 3:])]
        covariance = np.tile(
            np.diag(np.repeat(np.square(np.maximum(spread, 1e-9)), 3)), (len(covariance), 1, 1)
        )
    return np.linalg.inv(np.linalg.cholesky(covariance)).astype(np.float64)


def _result(
    problem: _Problem, state: State, whitening: FloatArray, weights: FloatArray, scale: float
) -> HandEye:
    free = problem.free
    residuals = problem.residuals(state)
    white = _applied(whitening, residuals)
    jacobian = whitening @ problem.jacobian(state)[:, :, free]
    information = np.einsum("n,nip,niq->npq", weights, jacobian, jacobian, optimize=True)
    scores = np.einsum("n,nip,ni->np", weights, jacobian, white)
    prior = np.diag(problem.prior_information[free])
    independent = _independent(information, prior, scale)
    found = _lasting(information, scores, prior, independent)
    covariance, bound = np.zeros((2, PARAMETERS, PARAMETERS))
    covariance[np.ix_(free, free)], bound[np.ix_(free, free)] = found, independent
    counts = weights > 0.0
    return HandEye(
        state=state,
        middle_ns=problem.middle_ns,
        covariance=covariance,
        independent=bound,
        motion=NO_MOTION,
        pairs=len(problem.measured),
        unused=0,
        outliers=int((~counts).sum()),
        scale=scale,
        block_correlation=_block_correlation(white[counts]),
        residual_m=_rms(residuals[counts, :3]),
        residual_rad=_rms(residuals[counts, 3:]),
        speed_m_s=_rms(problem.v_m_s),
        rate_rad_s=_rms(problem.w_rad_s),
    )


def _block_correlation(white: FloatArray) -> float:
    """Return the correlation of the mean residuals of successive blocks; 0 if blocks are independent."""
    means = np.stack([block.mean(axis=0) for block in np.array_split(white, _BLOCKS)])
    means -= means.mean(axis=0)
    return float((means[1:] * means[:-1]).sum() / max((means**2).sum(), 1e-30))


def _rms(vectors: FloatArray) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


def _independent(information: FloatArray, prior: FloatArray, scale: float) -> FloatArray:
    """Return the covariance of independent errors of the residuals' own size."""
    seen = information.sum(axis=0)
    inverse = np.linalg.inv(seen + prior)
    covariance: FloatArray = inverse @ (scale**2 * seen + prior) @ inverse
    return 0.5 * (covariance + covariance.T)


def _lasting(
    information: FloatArray, scores: FloatArray, prior: FloatArray, independent: FloatArray
) -> FloatArray:
    """Return the covariance from the solutions that lack one block of time each, to first order.

    It is at least that of independent errors, since few blocks tell little of the directions in which the
    parameters are known worst.
    """
    whole = information.sum(axis=0) + prior
    blocks = np.array_split(np.arange(len(scores)), _BLOCKS)
    moves = np.stack(
        [
            np.linalg.solve(whole - information[block].sum(axis=0), scores[block].sum(axis=0))
            for block in blocks
        ]
    )
    moves -= moves.mean(axis=0)
    inverse = np.linalg.inv(whole)
    values, vectors = eigh((_BLOCKS - 1) / _BLOCKS * moves.T @ moves + inverse @ prior @ inverse, independent)
    root = independent @ vectors  # vectors.T @ independent @ vectors = 1
    covariance: FloatArray = (root * np.maximum(values, 1.0)) @ root.T
    return covariance


def _applied(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    applied: FloatArray = (matrices @ vectors[:, :, None])[:, :, 0]
    return applied


def _rotvec(R: FloatArray) -> FloatArray:
    return Rotation.from_matrix(R, assume_valid=True).as_rotvec()


def _transposed(matrices: FloatArray) -> FloatArray:
    return np.swapaxes(matrices, 1, 2)


def _crossed(vectors: FloatArray) -> FloatArray:
    """Return the matrices [v x] of vectors, shape (N, 3, 3)."""
    matrices = np.zeros((len(vectors), 3, 3))
    for row, column, axis, sign in _CROSSED:
        matrices[:, row, column] = sign * vectors[:, axis]
    return matrices
