"""Error-state Kalman filter of pose and twist, with measurements that may come late.

State: position p and attitude R of the target in chaser axes, v = dp/dt, and w with dR/dt = [w]x R. Error,
all in chaser axes: (dp, dtheta, dv, dw), estimate minus truth, dtheta = Log(R_est R^T): the pose block of
the covariance is the one that the ICD publishes (section 1). Values are immutable, functions are pure.

Model: the velocity of the centre of mass and w are random walks. With phi = w dt the error propagates, to
first order in itself and exactly in phi, as dtheta+ = Exp(phi) dtheta + J_l(phi) dt dw (J_l is the left
Jacobian of SO(3)). The origin's rotation about the centre of mass, at R r from it, is kinematics, not noise:
a prediction transforms the state to the centre by p + R r and v + w x R r, propagates it, and transforms it
back. After an update by delta the attitude error is left-multiplied by J_l(delta). Source: J. Sola,
Quaternion kinematics for the error-state Kalman filter, arXiv:1711.02508, section 7 (errors in global axes),
with J_l in place of its first-order terms.

Where every turn about an axis of the target is a symmetry, the angle about this free axis is a convention. No
prediction and no update turns the target about it. Its variance is 0 inside the filter, and that of an
unknown angle in the published covariance. The rate about the axis is 0, with the variance of an unknown rate.
A sphere has three such axes: its position alone is estimated.
"""

from dataclasses import dataclass, field, replace
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import RigidTransform
from scipy.special import gammainc, gammaincinv

from rpod_pose.errors import PoseError
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.filter import FilterConfig
from rpod_schemas.poses import pose_of, rotation_matrix, rotation_of
from rpod_schemas.types import Odometry
from rpod_target import NO_SYMMETRY, Equivalence
from rpod_target.equivalence import FREE_SIGMA_RAD, with_variance_about

POSITION, ATTITUDE, VELOCITY, RATE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
POSE, TWIST = slice(0, 6), slice(6, 12)


class StampOrderError(PoseError):
    """The prediction would go back in time."""

    def __init__(self, state_ns: int, asked_ns: int) -> None:
        super().__init__(f"the state is of {state_ns} ns and cannot be predicted back to {asked_ns} ns")


@dataclass(frozen=True, eq=False)
class FilterState:
    """State of the filter at one time."""

    stamp_ns: int
    T_chaser_target: RigidTransform
    velocity_m_s: FloatArray
    """dp/dt of the target's origin, chaser axes, shape (3,)."""
    rate_rad_s: FloatArray
    """Rate of the target relative to the chaser, chaser axes, shape (3,)."""
    covariance: FloatArray
    """Covariance of (dp, dtheta, dv, dw), chaser axes, shape (12, 12)."""
    centre_of_mass_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Centre of mass r of the target, target axes, shape (3,)."""
    alike: Equivalence = NO_SYMMETRY
    """Which attitudes no measurement tells apart."""


class Update(NamedTuple):
    """Result of an update with a measurement."""

    state: FilterState
    """State after the update; unchanged if the measurement was rejected."""
    nis: float
    """Normalised innovation squared; NaN if the measurement is not finite."""
    accepted: bool


def start(
    T_chaser_target: RigidTransform,
    covariance: FloatArray,
    stamp_ns: int,
    *,
    config: FilterConfig,
    centre_of_mass_m: FloatArray | None = None,
    alike: Equivalence = NO_SYMMETRY,
) -> FilterState:
    """Return the state after a first measured pose, with an unknown twist.

    Args:
        T_chaser_target: measured pose.
        covariance: covariance of its (dp, dtheta), ICD section 1, shape (6, 6).
        stamp_ns: time of the measurement.
        config: noise of the filter.
        centre_of_mass_m: centre of mass of the target, target axes, shape (3,); by default its origin.
            Of a target with a free axis, the part along this axis counts, and of a sphere none.
        alike: which attitudes of the target no measurement tells apart.
    """
    centre_m = np.zeros(3) if centre_of_mass_m is None else centre_of_mass_m
    if len(alike.free_axes) == 1:
        centre_m = alike.free_axes[0] * (alike.free_axes[0] @ centre_m)
    elif len(alike.free_axes):
        centre_m = np.zeros(3)
    from_centre = np.eye(12)
    from_centre[VELOCITY, RATE] = _cross_matrix(rotation_matrix(T_chaser_target) @ centre_m)
    covariance = block_diag(
        _measurement_noise(covariance, config),
        config.initial_velocity_sigma_m_s**2 * np.eye(3),
        np.deg2rad(config.initial_rate_sigma_deg_s) ** 2 * np.eye(3),
    )
    state = FilterState(
        stamp_ns=stamp_ns,
        T_chaser_target=T_chaser_target,
        velocity_m_s=np.zeros(3),
        rate_rad_s=np.zeros(3),
        covariance=_symmetric(from_centre @ covariance @ from_centre.T),
        centre_of_mass_m=centre_m,
        alike=alike,
    )
    return _unturned(state, config)


def predict(state: FilterState, stamp_ns: int, config: FilterConfig) -> FilterState:
    """Return the state at a later stamp.

    Raises:
        StampOrderError: the stamp is earlier than the state's.
    """
    if stamp_ns < state.stamp_ns:
        raise StampOrderError(state.stamp_ns, stamp_ns)
    if stamp_ns == state.stamp_ns:
        return state
    step_s = (stamp_ns - state.stamp_ns) * 1e-9
    spin, R = _cross_matrix(state.rate_rad_s), rotation_matrix(state.T_chaser_target)
    phi = state.rate_rad_s * step_s
    turn = exponential(phi)
    arm_m = R @ state.centre_of_mass_m
    arm_after_m = turn @ arm_m
    centre_m_s = state.velocity_m_s + spin @ arm_m

    F = np.eye(12)
    F[POSITION, VELOCITY] = step_s * np.eye(3)
    F[ATTITUDE, ATTITUDE] = turn
    F[ATTITUDE, RATE] = step_s * left_jacobian(phi)
    from_centre = np.eye(12) - _swing(arm_after_m, spin)
    F = F @ (np.eye(12) + _swing(arm_m, spin))
    covariance = from_centre @ (F @ state.covariance @ F.T + _process_noise(step_s, config)) @ from_centre.T
    predicted = replace(
        state,
        stamp_ns=stamp_ns,
        T_chaser_target=pose_of(
            turn @ R, state.T_chaser_target.translation + arm_m + centre_m_s * step_s - arm_after_m
        ),
        velocity_m_s=centre_m_s - spin @ arm_after_m,
        covariance=_symmetric(covariance),
    )
    return _unturned(predicted, config)


def innovation_of(
    state: FilterState, T_chaser_target: RigidTransform, covariance: FloatArray, *, config: FilterConfig
) -> tuple[FloatArray, FloatArray]:
    """Return (dp, dtheta) from a prediction to a measured pose, shape (6,), and its noise, shape (6, 6).

    The covariance of the innovation is that of the state's pose and this noise together.
    """
    noise = _measurement_noise(covariance, config)
    # no innovation is left about a free axis; any variance keeps the matrix regular and leaves the gain at 0
    noise = state.alike.with_free_variance(noise, rotation_matrix(T_chaser_target), 1.0)
    return _pose_difference(T_chaser_target, state.T_chaser_target, state.alike), noise


def separation_of(state: FilterState, other: FilterState) -> FloatArray:
    """Return (dp, dtheta) from another filter's pose to a state's, at the same stamp, shape (6,)."""
    return _pose_difference(state.T_chaser_target, other.T_chaser_target, state.alike)


def update(
    state: FilterState, T_chaser_target: RigidTransform, covariance: FloatArray, *, config: FilterConfig
) -> Update:
    """Return the state after a pose measured at the state's stamp, unless the gate rejects it.

    The measured attitude stands for all that no measurement tells from it: the nearest counts, and the angle
    about a free axis is ignored.

    Args:
        state: state predicted to the measurement's stamp.
        T_chaser_target: the measured pose.
        covariance: covariance of its (dp, dtheta), ICD section 1, shape (6, 6); rejected if not finite.
        config: noise floor, inflation and gate.
    """
    innovation, noise = innovation_of(state, T_chaser_target, covariance, config=config)
    if not (np.isfinite(innovation).all() and np.isfinite(noise).all()):
        return Update(state, float("nan"), accepted=False)

    S = state.covariance[POSE, POSE] + noise
    nis = float(innovation @ np.linalg.solve(S, innovation))
    gate_nis = _gate(config.tuning.gate_nis, state.alike.dof)
    if not 0.0 <= nis <= gate_nis:  # negative: the covariance is not positive definite
        return Update(state, nis, accepted=False)

    gain = np.linalg.solve(S, state.covariance[POSE]).T
    correction = gain @ innovation
    reset = np.eye(12)
    reset[ATTITUDE, ATTITUDE] = left_jacobian(correction[ATTITUDE])
    keep = np.eye(12)
    keep[:, POSE] -= gain
    joseph = keep @ state.covariance @ keep.T + gain @ noise @ gain.T
    corrected = replace(_corrected(state, correction), covariance=_symmetric(reset @ joseph @ reset.T))
    return Update(_unturned(corrected, config), nis, accepted=True)


def is_consistent(state: FilterState, other: FilterState, config: FilterConfig) -> bool:
    """Return whether another filter's pose at the same stamp lies within the gate of a state.

    The other filter has used the same measurements and more, so that the covariance of the difference is at
    most the state's own.
    """
    difference = _pose_difference(other.T_chaser_target, state.T_chaser_target, state.alike)
    R = rotation_matrix(state.T_chaser_target)
    covariance = state.alike.with_free_variance(state.covariance[POSE, POSE].copy(), R, 1.0)
    nis = float(difference @ np.linalg.solve(covariance, difference))
    return 0.0 <= nis <= _gate(config.tuning.gate_nis, state.alike.dof)


def to_odometry(state: FilterState, *, frame_id: str, child_frame_id: str) -> Odometry:
    """Return the state as an odometry message: twist and its covariance in child axes.

    With v_child = R^T v the error is R^T (dv + v x dtheta) to first order, and likewise for the rate, so
    the twist's covariance includes its correlation with the attitude error. The angle about a free axis has
    the variance of an unknown angle; the twist is given in the axes that the published attitude has.
    """
    R = rotation_matrix(state.T_chaser_target)
    R_target_chaser = R.T
    jacobian = np.zeros((6, 12))
    jacobian[0:3, ATTITUDE] = R_target_chaser @ _cross_matrix(state.velocity_m_s)
    jacobian[3:6, ATTITUDE] = R_target_chaser @ _cross_matrix(state.rate_rad_s)
    jacobian[0:3, VELOCITY] = jacobian[3:6, RATE] = R_target_chaser
    return Odometry(
        stamp_ns=state.stamp_ns,
        frame_id=frame_id,
        child_frame_id=child_frame_id,
        pose=state.T_chaser_target,
        linear_m_s=R_target_chaser @ state.velocity_m_s,
        angular_rad_s=R_target_chaser @ state.rate_rad_s,
        pose_covariance=state.alike.with_free_variance(
            state.covariance[POSE, POSE].copy(), R, FREE_SIGMA_RAD**2
        ),
        twist_covariance=_symmetric(jacobian @ state.covariance @ jacobian.T),
    )


def left_jacobian(phi: FloatArray) -> FloatArray:
    """Return J_l of SO(3), shape (3, 3): Exp(phi + d) = Exp(J_l(phi) d) Exp(phi) to first order in d."""
    angle = float(np.linalg.norm(phi))
    if angle < 1e-4:  # the closed form loses digits that the series keeps
        first, second = 0.5, 1.0 / 6.0
    else:
        first = 2.0 * (np.sin(0.5 * angle) / angle) ** 2
        second = (angle - np.sin(angle)) / angle**3
    cross = _cross_matrix(phi)
    return np.eye(3) + first * cross + second * cross @ cross


def exponential(phi: FloatArray) -> FloatArray:
    """Return Exp(phi) of SO(3), shape (3, 3), as 1 + [phi]x J_l(phi)."""
    return np.eye(3) + _cross_matrix(phi) @ left_jacobian(phi)


def _orthonormal(R: FloatArray) -> FloatArray:
    """Return a rotation matrix without the rounding errors of many products, by one Newton step."""
    return R @ (1.5 * np.eye(3) - 0.5 * R.T @ R)


def _unturned(state: FilterState, config: FilterConfig) -> FilterState:
    """Return a state with no error of the angles about free axes, and with unknown rates about them."""
    if not len(state.alike.free_axes):
        return state
    axes = state.alike.free_axes @ rotation_matrix(state.T_chaser_target).T
    sigma_rad_s = np.deg2rad(config.initial_rate_sigma_deg_s)
    covariance = with_variance_about(state.covariance, axes, 0.0, first=ATTITUDE.start)
    covariance = with_variance_about(covariance, axes, sigma_rad_s**2, first=RATE.start)
    rate_rad_s = state.rate_rad_s - axes.T @ (axes @ state.rate_rad_s)
    return replace(state, rate_rad_s=rate_rad_s, covariance=covariance)


@cache
def _gate(gate_nis: float, dof: int) -> float:
    """Return the quantile of chi-squared that is as probable as the gate is with six degrees of freedom."""
    return gate_nis if dof == 6 else 2.0 * float(gammaincinv(dof / 2.0, float(gammainc(3.0, gate_nis / 2.0))))


def _pose_difference(
    T_measured: RigidTransform, T_estimated: RigidTransform, alike: Equivalence
) -> FloatArray:
    """Return (dp, dtheta) from the estimated to the nearest measured pose, shape (6,), m and rad."""
    estimated = rotation_of(T_estimated)
    measured = alike.nearest(rotation_of(T_measured), estimated)
    turn_rad = (measured * estimated.inv()).as_rotvec()
    return np.concatenate([T_measured.translation - T_estimated.translation, turn_rad])


def _corrected(state: FilterState, correction: FloatArray) -> FilterState:
    pose = state.T_chaser_target
    R = exponential(correction[ATTITUDE]) @ rotation_matrix(pose)
    return replace(
        state,
        T_chaser_target=pose_of(_orthonormal(R), pose.translation + correction[POSITION]),
        velocity_m_s=state.velocity_m_s + correction[VELOCITY],
        rate_rad_s=state.rate_rad_s + correction[RATE],
    )


def _measurement_noise(covariance: FloatArray, config: FilterConfig) -> FloatArray:
    floor = np.repeat([config.position_floor_m**2, np.deg2rad(config.attitude_floor_deg) ** 2], 3)
    return config.correlation_inflation * (covariance + np.diag(floor))


def _swing(arm_m: FloatArray, spin: FloatArray) -> FloatArray:
    """Return N, shape (12, 12): errors at the end of an arm on the target are 1 + N times those here.

    From p + a and v + w x a with da = dtheta x a, where ``spin`` is [w]x. N N = 0, so the way back is 1 - N.
    """
    cross = _cross_matrix(arm_m)
    N = np.zeros((12, 12))
    N[POSITION, ATTITUDE] = N[VELOCITY, RATE] = -cross
    N[VELOCITY, ATTITUDE] = -spin @ cross
    return N


def _process_noise(step_s: float, config: FilterConfig) -> FloatArray:
    """Return the noise that white accelerations cause in a step, shape (12, 12)."""
    densities = (config.acceleration_density_m2_s3, config.angular_acceleration_density_rad2_s3)
    density = np.diag(np.repeat(densities, 3))
    Q = np.empty((12, 12))
    Q[POSE, POSE] = step_s**3 / 3.0 * density
    Q[POSE, TWIST] = Q[TWIST, POSE] = step_s**2 / 2.0 * density
    Q[TWIST, TWIST] = step_s * density
    return Q


def _symmetric(matrix: FloatArray) -> FloatArray:
    return 0.5 * (matrix + matrix.T)


def _cross_matrix(vector: FloatArray) -> FloatArray:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
