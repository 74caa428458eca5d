"""First values of a hand-eye calibration: the clock by the rates of rotation, then mount and holder.

Mount and holder do not change the rates of rotation, so that the correlation of the rates in both series
gives the clock's offset. Relative motions C X = X A then give the mount: rotation vectors by Park and Martin
(IEEE Trans. Robotics 10(5), 1994), here by ``Rotation.align_vectors``, and the position by linear least
squares.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate, correlation_lags
from scipy.spatial.transform import Rotation

from rpod_analysis.calibration.hand_eye.poses import Interpolated, StampedPoses
from rpod_analysis.errors import CalibrationError
from rpod_schemas.arrays import MAD_TO_SIGMA, FloatArray

_GRID_S = 0.02
_RATE_OVER_S = 0.4
"""Time over which a rate of rotation is taken, s: long enough that noise of the attitudes hardly matters."""
_LEAST_OVERLAP = 0.5
_MOST_POSES = 240
"""Number of poses, taken evenly, whose relative motions give the first values."""
_LEAST_TURN_RAD = np.radians(2.0)
_SIGMAS = 5.0
"""Rotation about a second axis that counts as measured, in standard deviations of the attitudes' noise."""
_OUTLIER = 4.0
"""Greatest difference of two motions' angles, in robust standard deviations; Daniilidis 1999, section 6,
drops motions by the same test."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Rotation of the target relative to the chaser, in chaser axes."""

    axes: FloatArray
    """Directions of the most, the second and the least turning, rows, shape (3, 3)."""
    turned_deg: FloatArray
    """RMS rotation between two poses about each of them, shape (3,)."""
    noise_deg: float
    """Noise of such a rotation, from the difference between both series."""

    @property
    def turns_about_two_axes(self) -> bool:
        """Whether mount and holder can be found."""
        return bool(self.turned_deg[1] > max(_SIGMAS * self.noise_deg, np.degrees(_LEAST_TURN_RAD)))

    def missing(self) -> str:
        """Return in words which motion is missing."""
        first, second, third = self.turned_deg
        axis = ", ".join(f"{value:.2f}" for value in self.axes[0])
        if first <= max(_SIGMAS * self.noise_deg, np.degrees(_LEAST_TURN_RAD)):
            return (
                f"the target turned by {first:.2g} deg only (RMS between two poses; noise "
                f"{self.noise_deg:.2g} deg): neither the mount nor the holder can be found. Turn it about "
                "two axes, by 30 deg or more about each"
            )
        return (
            f"the target turned about one axis, ({axis}) of the chaser, by {first:.3g} deg, and about the "
            f"others by {second:.2g} and {third:.2g} deg (RMS; noise {self.noise_deg:.2g} deg): the mount's "
            "position along this axis and its turn about it cannot be found. Turn it about a second axis "
            "too, by 30 deg or more"
        )


NO_MOTION = Motion(np.eye(3), np.zeros(3), 0.0)


def offset_by_rates(measured: StampedPoses, truth: StampedPoses) -> float | None:
    """Return the length by which the sensor's clock is ahead, s, from rates of rotation; None if unknown."""
    rates = [_rates_rad_s(poses) for poses in (measured, truth)]
    if min(rate.size for rate in rates) < 2 or min(rate.std() for rate in rates) == 0.0:
        return None
    a, b = (np.subtract(rate, rate.mean()) for rate in rates)
    overlap = correlate(np.ones_like(a), np.ones_like(b))
    energy = np.sqrt(correlate(a**2, np.ones_like(b)) * correlate(np.ones_like(a), b**2))
    enough = overlap > _LEAST_OVERLAP * min(a.size, b.size)
    score = np.where(enough, correlate(a, b) / np.maximum(energy, np.finfo(float).tiny), -np.inf)
    lag_s = _GRID_S * float(correlation_lags(a.size, b.size)[np.argmax(score)])
    return lag_s + 1e-9 * float(measured.stamp_ns[0] - truth.stamp_ns[0])


def _rates_rad_s(poses: StampedPoses) -> FloatArray:
    """Return the rate of rotation on a grid from the first stamp on, rad/s; empty for a short series."""
    duration_s = 1e-9 * float(poses.stamp_ns[-1] - poses.stamp_ns[0])
    time_s = np.arange(0.0, duration_s - _RATE_OVER_S, _GRID_S)
    there, stamps = Interpolated(poses), np.full(time_s.size, poses.stamp_ns[0])
    before, after = (there.at(stamps, time_s + shift_s)[0] for shift_s in (0.0, _RATE_OVER_S))
    turn = Rotation.from_matrix(before).inv() * Rotation.from_matrix(after)
    return np.asarray(turn.magnitude(), np.float64) / _RATE_OVER_S


def relative_motions(
    measured: tuple[FloatArray, FloatArray], truth: tuple[FloatArray, FloatArray]
) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray], Motion]:
    """Return relative motions A of the sensor's poses and C of the truth's (C X = X A), and their rotations.

    Args:
        measured: rotations, (N, 3, 3), and positions, (N, 3), of T_sensor_target.
        truth: those of T_chaser_holder at the same times.
    """
    first, second = _pairs(measured[0].shape[0])
    A, C = _between(*measured, first, second), _between(*truth, first, second)
    a, c = (Rotation.from_matrix(motion[0]).as_rotvec() for motion in (A, C))
    differs = np.linalg.norm(a, axis=1) - np.linalg.norm(c, axis=1)
    noise = MAD_TO_SIGMA * float(np.median(np.abs(differs)))
    kept = np.abs(differs) <= _OUTLIER * max(noise, 1e-9)
    kept &= np.linalg.norm(c, axis=1) < np.radians(170.0)  # at half a turn the axis has no sign
    if not kept.any():
        raise CalibrationError(
            "no two poses of sensor and truth turn by the same angle: are they of one body?"
        )
    values, vectors = np.linalg.eigh(np.einsum("ni,nj->ij", c[kept], c[kept]) / kept.sum())
    motion = Motion(
        axes=vectors.T[::-1],
        turned_deg=np.degrees(np.sqrt(values[::-1].clip(0.0))),
        noise_deg=float(np.degrees(noise)),
    )
    return (A[0][kept], A[1][kept]), (C[0][kept], C[1][kept]), motion


def mount_of(
    A: tuple[FloatArray, FloatArray], C: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return rotation matrix and position of the mount X from relative motions with C X = X A."""
    a, c = (Rotation.from_matrix(motion[0]).as_rotvec() for motion in (A, C))
    R_X = Rotation.align_vectors(c, a)[0].as_matrix()
    design = (C[0] - np.eye(3)).reshape(-1, 3)
    t_X = np.linalg.lstsq(design, (A[1] @ R_X.T - C[1]).reshape(-1))[0]
    return R_X, t_X.astype(np.float64)


def holder_of(
    mount: tuple[FloatArray, FloatArray],
    measured: tuple[FloatArray, FloatArray],
    truth: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Return rotation matrix and position of Y = B^-1 X S, the mean of all poses; the positions' median."""
    R_B_T = np.swapaxes(truth[0], 1, 2)
    R_Y = Rotation.from_matrix(R_B_T @ mount[0] @ measured[0]).mean().as_matrix()
    in_chaser = measured[1] @ mount[0].T + mount[1] - truth[1]
    return R_Y, np.median(np.einsum("nij,nj->ni", R_B_T, in_chaser), axis=0)


def _pairs(count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    chosen = np.unique(np.linspace(0, count - 1, min(count, _MOST_POSES)).astype(np.intp))
    first, second = np.triu_indices(chosen.size, 1)
    kept = slice(None, None, max(1, first.size // 6000))
    return chosen[first[kept]], chosen[second[kept]]


def _between(
    R: FloatArray, t_m: FloatArray, first: NDArray[np.intp], second: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray]:
    """Return the motions T_i T_j^-1 in the axes of the parent frame."""
    turned = R[first] @ np.swapaxes(R[second], 1, 2)
    return turned, t_m[first] - np.einsum("nij,nj->ni", turned, t_m[second])
