"""Mount, holder, clock and depth offset of a sensor in one robust fit, with their covariance.

X S_i = B(stamp_i - offset_i) Y, where S_i = T_sensor_target is measured, B = T_chaser_holder is the truth
over time, X = T_chaser_sensor is the mount and Y = T_holder_target the holder. Sensor and truth have
covariances; a residual is weighted by their sum. Pairs with large residuals count less (Tukey's biweight of
the Mahalanobis distance). Successive errors are correlated, so the covariance of the result is a jackknife
over blocks of time.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from rpod_analysis.calibration.hand_eye.jackknife import (
    block_correlation,
    independent_covariance,
    lasting_covariance,
)
from rpod_analysis.calibration.hand_eye.parameters import (
    DEPTH,
    DRIFT,
    PARAMETERS,
    Assumptions,
    HandEye,
    State,
)
from rpod_analysis.calibration.hand_eye.poses import Interpolated, StampedPoses
from rpod_analysis.calibration.hand_eye.problem import TWIST_S, Problem
from rpod_analysis.calibration.hand_eye.start import (
    NO_MOTION,
    Motion,
    holder_of,
    mount_of,
    offset_by_rates,
    relative_motions,
)
from rpod_analysis.errors import CalibrationError
from rpod_analysis.scoring.score import MOST_GAP
from rpod_schemas.arrays import MAD_TO_SIGMA, FloatArray

_ROUNDS = 20
_TUKEY = 7.0
"""Mahalanobis distance beyond which a pair does not count, in robust standard deviations: 97 % efficient for
normal errors in six dimensions."""
_MEDIAN_OF_6 = 5.348
"""Median of chi-squared with six degrees of freedom."""
_SETTLED = 1e-7
"""Greatest step of a parameter, m, rad or s, at which the fit has converged."""
_LEAST_PAIRS = 30


def fit_hand_eye(measured: StampedPoses, truth: StampedPoses, known: Assumptions | None = None) -> HandEye:
    """Return the mount, holder, clock and depth offset with which the truth best explains a sensor's poses.

    Args:
        measured: poses T_sensor_target with the sensor's stamps.
        truth: poses T_chaser_holder with those of the truth.
        known: prior knowledge.

    Raises:
        CalibrationError: the poses are too few, or the motion does not determine the mount; the text says
            which motion is missing.
    """
    known = known or Assumptions()
    measured, truth = measured.in_order(), truth.in_order()
    if min(len(measured), len(truth)) < _LEAST_PAIRS:
        raise CalibrationError(
            f"{len(measured)} poses of the sensor and {len(truth)} of the truth, needs {_LEAST_PAIRS} of "
            "each: log the motion for longer"
        )
    by_rates_s = offset_by_rates(measured, truth)
    far = by_rates_s is not None and abs(by_rates_s) > TWIST_S
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
        if abs(found.state.offset_s - offset_s) > TWIST_S:  # then other pairs have truth around them
            found = _fit_pairs(measured, truth, known, found.state.offset_s)
        return found
    except CalibrationError as error:
        return error


def _fit_pairs(measured: StampedPoses, truth: StampedPoses, known: Assumptions, offset_s: float) -> HandEye:
    usual_s = 1e-9 * float(np.median(np.diff(truth.stamp_ns)))
    gaps_s = [truth.gap_s(measured.stamp_ns, -offset_s + shift_s) for shift_s in (-TWIST_S, 0.0, TWIST_S)]
    kept = np.max(gaps_s, axis=0) <= MOST_GAP * usual_s
    if kept.sum() < _LEAST_PAIRS:
        raise CalibrationError(
            f"{int(kept.sum())} poses of the sensor have truth around them, needs {_LEAST_PAIRS}; the first "
            f"stamp is {1e-9 * float(measured.stamp_ns[0] - truth.stamp_ns[0]):.3f} s after the truth's "
            "first: log both at the same time, and set their clocks alike"
        )
    problem = Problem(measured.at(kept), Interpolated(truth), known)
    state, motion = _start(problem, offset_s)
    return replace(_solve(problem, state), motion=motion, unused=int((~kept).sum()))


def _start(problem: Problem, offset_s: float) -> tuple[State, Motion]:
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


def _solve(problem: Problem, state: State) -> HandEye:
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


def _step(problem: Problem, state: State, whitening: FloatArray) -> FloatArray:
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


def _whitening(problem: Problem, state: State) -> FloatArray:
    """Return W with W C W^T = 1 for each pair's covariance C, shape (N, 6, 6).

    Where the covariances are not known, the spread of the residuals stands for them.
    """
    covariance = problem.covariance(state)
    if not (np.diagonal(covariance, axis1=1, axis2=2) > 0.0).all():
        residuals = np.abs(problem.residuals(state))
        spread = [MAD_TO_SIGMA * float(np.median(part)) for part in (residuals[:, :3], residuals[:, 3:])]
        covariance = np.tile(
            np.diag(np.repeat(np.square(np.maximum(spread, 1e-9)), 3)), (len(covariance), 1, 1)
        )
    return np.linalg.inv(np.linalg.cholesky(covariance)).astype(np.float64)


def _result(
    problem: Problem, state: State, whitening: FloatArray, weights: FloatArray, scale: float
) -> HandEye:
    free = problem.free
    residuals = problem.residuals(state)
    white = _applied(whitening, residuals)
    jacobian = whitening @ problem.jacobian(state)[:, :, free]
    information = np.einsum("n,nip,niq->npq", weights, jacobian, jacobian, optimize=True)
    scores = np.einsum("n,nip,ni->np", weights, jacobian, white)
    prior = np.diag(problem.prior_information[free])
    independent = independent_covariance(information, prior, scale)
    found = lasting_covariance(information, scores, prior, independent)
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
        block_correlation=block_correlation(white[counts]),
        residual_m=_rms(residuals[counts, :3]),
        residual_rad=_rms(residuals[counts, 3:]),
        speed_m_s=_rms(problem.v_m_s),
        rate_rad_s=_rms(problem.w_rad_s),
    )


def _rms(vectors: FloatArray) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


def _applied(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    applied: FloatArray = (matrices @ vectors[:, :, None])[:, :, 0]
    return applied
