"""Rotation of a rigid body without torque, with its derivatives.

Euler's equations in body axes read J dw/dt = -w x J w, the attitude follows from dM/dt = M [w]x, M(0) = 1.
They are integrated together with their derivatives with respect to the initial rate and to the inertia, by
the classical method of Runge and Kutta (E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential
Equations I, section II.1).

Without torque the scale of the inertia does not matter, and its principal axes are taken as declared, so two
ratios remain. With the principal moments J_i of the declared inertia, the moments in use are J_i exp(S_i),
where S = c_1 e_1 + c_2 e_2 and e_1, e_2 are orthogonal vectors of norm 1 and sum 0. So the moments are
positive for any coefficients c, and c = 0 is the declared inertia. If one moment is wrong by a share e, |c|
is about 0.8 e.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from rpod_pose.navigation.filter.rotations import cross_matrix, exponential, left_jacobian
from rpod_schemas.arrays import FloatArray

RATIOS = 2
"""Number of coefficients of an inertia's ratios. Physics: there are three moments, and their common factor
has no effect on a motion without torque."""
_BASIS = np.array([[1.0, -1.0, 0.0], [1.0, 1.0, -2.0]]) / np.sqrt([[2.0], [6.0]])
"""Orthonormal changes of the logarithms of three moments. Physics: they keep the product, which no motion
without torque shows."""
_STEP_RAD = 0.1
"""Largest turn in a step of the integration. Numerics: the error of a step is about 1e-7 rad."""


@dataclass(frozen=True, eq=False)
class Inertia:
    """The declared inertia of a body, and the inertias with other ratios of the moments.

    Args:
        declared_kg_m2: inertia about the centre of mass, target axes, shape (3, 3).
    """

    declared_kg_m2: FloatArray

    @cached_property
    def _principal(self) -> tuple[FloatArray, FloatArray]:
        """Principal moments over their sum, shape (3,), and principal axes as columns, shape (3, 3)."""
        moments, axes = np.linalg.eigh(self.declared_kg_m2 / np.trace(self.declared_kg_m2))
        return moments, axes

    def shaped(self, coefficients: FloatArray) -> "Shape":
        """Return the inertia for coefficients, shape (2,); shape (0,) gives the declared inertia."""
        moments, axes = self._principal
        used = _BASIS[: len(coefficients)]
        shaped: FloatArray = moments * np.exp(coefficients @ used)
        return Shape((axes * shaped) @ axes.T, (axes * (used * shaped)[:, None]) @ axes.T)

    def matrices(self, coefficients: FloatArray) -> FloatArray:
        """Return the inertias for P coefficients, shape (P, 2) or (P, 0), as matrices, shape (P, 3, 3)."""
        moments, axes = self._principal
        shaped = moments * np.exp(coefficients @ _BASIS[: coefficients.shape[1]])
        inertias: FloatArray = (axes * shaped[:, None]) @ axes.T
        return inertias


class Shape(NamedTuple):
    """An inertia of any scale, and its derivatives with respect to the coefficients."""

    J: FloatArray
    """Inertia, target axes, shape (3, 3)."""
    by_coefficient: FloatArray
    """Derivatives of J, shape (2, 3, 3), or (0, 3, 3) if the ratios are not estimated."""


class Turned(NamedTuple):
    """Rotation of a body in a step, and its derivatives, all in body axes.

    Errors of the turn are right-multiplied, in axes at the end: M_estimated = M_true Exp(error).
    """

    turn: FloatArray
    """Rotation matrix M from body axes at the end to body axes at the start, shape (3, 3)."""
    rate_rad_s: FloatArray
    """Rate relative to inertial space at the end, shape (3,)."""
    turn_by_rate: FloatArray
    """Derivatives of the turn with respect to the rate at the start, shape (3, 3)."""
    rate_by_rate: FloatArray
    """Derivatives of the rate with respect to the rate at the start, shape (3, 3)."""
    turn_by_shape: FloatArray
    """Derivatives of the turn with respect to the coefficients of the inertia, shape (3, K)."""
    rate_by_shape: FloatArray
    """Derivatives of the rate with respect to the coefficients of the inertia, shape (3, K)."""


@dataclass
class _Integration:
    """Right-hand side of the integrated differential equations, for an inertia."""

    shape: Shape
    inverse: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self.inverse = np.linalg.inv(self.shape.J).astype(np.float64)

    def slope(self, y: FloatArray) -> FloatArray:
        """Return dy/dt of y = (quaternion x y z w, rate, derivatives of rate and of turn, row by row)."""
        quaternion, w = y[:4], y[4:7]
        by_all = y[7:].reshape(2, 3, -1)
        J, parts = self.shape
        spin, momentum = cross_matrix(w), J @ w
        w_slope = -self.inverse @ (spin @ momentum)
        rate_slope = self.inverse @ (cross_matrix(momentum) - spin @ J) @ by_all[0]
        if len(parts):
            forced = parts @ w_slope + (parts @ w) @ spin.T
            rate_slope[:, 3:] -= self.inverse @ forced.T
        turn_slope = by_all[0] - spin @ by_all[1]
        x, y_, z = w
        turning = np.array([[0.0, z, -y_, x], [-z, 0.0, x, y_], [y_, -x, 0.0, z], [-x, -y_, -z, 0.0]])
        return np.concatenate([0.5 * turning @ quaternion, w_slope, rate_slope.ravel(), turn_slope.ravel()])


def torque_free(rate_rad_s: FloatArray, shape: Shape, step_s: float) -> Turned:
    """Return the rotation without torque in a step.

    Args:
        rate_rad_s: rate relative to inertial space at the start, body axes, shape (3,).
        shape: inertia, of any scale.
        step_s: time, s.
    """
    count = 3 + len(shape.by_coefficient)
    start = np.zeros((2, 3, count))
    start[0, :, :3] = np.eye(3)
    y = np.concatenate([[0.0, 0.0, 0.0, 1.0], rate_rad_s, start.ravel()])
    steps = max(1, int(np.ceil(float(np.linalg.norm(rate_rad_s)) * step_s / _STEP_RAD)))
    y = _integrated(y, _Integration(shape).slope, step_s, steps)
    by_all = y[7:].reshape(2, 3, count)
    return Turned(
        turn=_matrix(y[:4]),
        rate_rad_s=y[4:7],
        turn_by_rate=by_all[1, :, :3],
        rate_by_rate=by_all[0, :, :3],
        turn_by_shape=by_all[1, :, 3:],
        rate_by_shape=by_all[0, :, 3:],
    )


class Curvature(NamedTuple):
    """Change of turn and rate by the second-order terms of the motion, body axes at the end."""

    mean: FloatArray
    """Mean change of the turn, as a rotation vector, and of the rate, shape (6,)."""
    spread: FloatArray
    """Root of the covariance of the change: the covariance is spread spread^T, shape (6, K)."""


FLAT = Curvature(np.zeros(6), np.zeros((6, 0)))
"""Curvature of a motion whose second-order terms are negligible."""


def curvature(
    rate_rad_s: FloatArray, coefficients: FloatArray, inertia: Inertia, root: FloatArray, step_s: float
) -> Curvature:
    """Return the second-order terms of the motion for a normal distribution of rate and inertia.

    With second differences D over h = sqrt(3) standard deviations along the columns i and j of a root of the
    covariance, D_ij = h^2 H_ij, the mean is sum H_ii / 2, and the covariance is sum H_ij H_ij^T / 2 over all
    i, j (M. Norgaard, N. K. Poulsen, O. Ravn, New developments in state estimation for nonlinear systems,
    Automatica 36 (2000) 1627-1638). The mixed terms are needed: along principal axes, Euler's equations have
    no others.

    Args:
        rate_rad_s: rate at the start, body axes, shape (3,).
        coefficients: those of the inertia's ratios, shape (2,) or (0,).
        inertia: the declared inertia.
        root: root of the covariance of (rate, coefficients), shape (D, D), D = 5 or 3.
        step_s: time, s.
    """
    count, steps = root.shape[1], np.sqrt(3.0) * root.T
    first, second = np.triu_indices(count, 1)
    pairs = steps[first] + steps[second]
    points = np.concatenate([np.zeros((1, len(root))), steps, -steps, pairs, -pairs])
    turns, rates = _turned(rate_rad_s + points[:, :3], inertia.matrices(coefficients + points[:, 3:]), step_s)
    change = np.hstack([(turns[0].inv() * turns).as_rotvec(), rates - rates[0]])[1:]
    own = change[:count] + change[count : 2 * count]
    mixed = change[2 * count :].reshape(2, -1, 6).sum(axis=0) - own[first] - own[second]
    return Curvature(own.sum(axis=0) / 6.0, np.concatenate([own / np.sqrt(18.0), mixed / 6.0]).T)


def _turned(rates_rad_s: FloatArray, J: FloatArray, step_s: float) -> tuple[Rotation, FloatArray]:
    """Return P turns, and the rates at the end, shape (P, 3), of P bodies in a step without torque."""
    inverse = np.linalg.inv(J)

    def slope(y: FloatArray) -> FloatArray:
        """Return dy/dt of y = (quaternion x y z w, rate), shape (7, P)."""
        vector, scalar, w = y[:3], y[3], y[4:]
        momentum = np.einsum("pij,jp->ip", J, w)
        change = np.einsum("pij,jp->ip", inverse, np.cross(momentum, w, axis=0))
        turning = 0.5 * (scalar * w + np.cross(vector, w, axis=0))
        return np.concatenate([turning, -0.5 * (vector * w).sum(axis=0, keepdims=True), change])

    y = np.vstack([np.tile([[0.0], [0.0], [0.0], [1.0]], len(J)), rates_rad_s.T])
    fastest_rad_s = float(np.linalg.norm(rates_rad_s, axis=1).max())
    y = _integrated(y, slope, step_s, max(1, int(np.ceil(fastest_rad_s * step_s / _STEP_RAD))))
    return Rotation.from_quat(y[:4].T), y[4:].T


def _integrated(
    y: FloatArray, slope: Callable[[FloatArray], FloatArray], step_s: float, steps: int
) -> FloatArray:
    """Return y after a step, by the method of Runge and Kutta in a number of equal parts."""
    h = step_s / steps
    for _ in range(steps):
        k1 = slope(y)
        k2 = slope(y + 0.5 * h * k1)
        k3 = slope(y + 0.5 * h * k2)
        k4 = slope(y + h * k3)
        y = y + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    return y


def constant_rate(rate_rad_s: FloatArray, step_s: float) -> Turned:
    """Return the rotation of a body whose rate is constant, which is that of a sphere without torque."""
    phi = rate_rad_s * step_s
    empty = np.zeros((3, 0))
    return Turned(exponential(phi), rate_rad_s, step_s * left_jacobian(phi).T, np.eye(3), empty, empty)


def _matrix(quaternion_xyzw: FloatArray) -> FloatArray:
    """Return the rotation matrix of a quaternion of any norm."""
    x, y, z, w = (quaternion_xyzw / np.linalg.norm(quaternion_xyzw)).tolist()
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )
