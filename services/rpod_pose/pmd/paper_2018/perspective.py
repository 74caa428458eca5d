"""A pose from points and their places in the image: EPnP, its refinement, what it can be trusted with.

Klionovska et al., Robotics 7(1), 2018, section 3.3.2, Eqs. 5 to 7; the solver is OpenCV's (Lepetit et
al., Int. J. Comput. Vis. 81, 2009). Places are straightened, so the camera is a pinhole. The refinement
minimises the reprojection error by Gauss-Newton steps with the perturbation of ``normal_equations``.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from scipy.spatial.transform import RigidTransform

from rpod_pose.registration.lie_group import turned
from rpod_pose.registration.normal_equations import add_residual, solve
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import pose_of
from rpod_schemas.types import Camera

SETTLED = 1e-6
"""A step of less, m and rad, ends the refinement."""
BEHIND_M = 1e-3
PRIOR_RESIDUALS = 4.0
"""The assumed noise counts as so many residuals: six or seven points say little about their own spread."""
WORST_CONDITION = 1e10


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Points of the model and where the image shows them."""

    points_m: FloatArray
    """Target axes, shape (N, 3)."""
    pixels: FloatArray
    """Straightened column and row, shape (N, 2)."""

    def __len__(self) -> int:
        return len(self.points_m)

    def without(self, number: int) -> "Correspondences":
        """Return the same without one point."""
        kept = np.arange(len(self)) != number
        return Correspondences(self.points_m[kept], self.pixels[kept])

    @property
    def relief(self) -> float:
        """Extent of the points across their common plane over that along it: 0 where they are coplanar."""
        extents = np.linalg.svd(self.points_m - self.points_m.mean(axis=0), compute_uv=False)
        return float(extents[2] / extents[0]) if extents[0] > 0.0 else 0.0


@dataclass(frozen=True, eq=False)
class Fit:
    """A pose and how its points reproject."""

    T_sensor_target: RigidTransform
    errors_px: FloatArray
    """Projected minus seen, shape (N, 2)."""
    information: FloatArray
    """J^T J of the errors by (dtau, dtheta) in target axes, 1/px^2 to be scaled, shape (6, 6)."""

    @property
    def distances_px(self) -> FloatArray:
        """How far each point reprojects from its place, shape (N,)."""
        distances: FloatArray = np.sqrt((self.errors_px**2).sum(axis=1))
        return distances

    @property
    def rms_px(self) -> float:
        """Root mean square of the distances."""
        return float(np.sqrt((self.errors_px**2).sum(axis=1).mean()))

    def covariance(self, noise_px: float) -> FloatArray:
        """Return the covariance of (dp, dtheta) in the sensor's fixed axes (ICD section 1), shape (6, 6).

        s^2 (J^T J)^-1 with s the spread of the errors, no less than ``noise_px``. NaN where the points leave
        a motion undetermined.
        """
        if not np.linalg.cond(self.information) < WORST_CONDITION:
            return np.full((6, 6), np.nan)
        freedom = max(self.errors_px.size - 6, 0)
        squares = PRIOR_RESIDUALS * noise_px**2 + float((self.errors_px**2).sum())
        variance_px2 = max(squares / (PRIOR_RESIDUALS + freedom), noise_px**2)
        to_sensor = np.kron(np.eye(2), self.T_sensor_target.rotation.as_matrix())
        covariance: FloatArray = variance_px2 * to_sensor @ np.linalg.inv(self.information) @ to_sensor.T
        return covariance


def pose_from_points(points: Correspondences, camera: Camera, *, iterations: int) -> Fit | None:
    """Return the pose by EPnP, refined; None where it is not before the camera.

    Args:
        points: four or more, not in one plane.
        camera: its matrix; the distortion is not asked.
        iterations: most Gauss-Newton steps; 0 for what EPnP gives.
    """
    found, turn, position = cv2.solvePnP(
        points.points_m, points.pixels, camera.K, None, flags=cv2.SOLVEPNP_EPNP
    )
    R, t = np.asarray(cv2.Rodrigues(turn)[0], np.float64), np.asarray(position, np.float64).ravel()
    if not found or not (np.isfinite(R).all() and np.isfinite(t).all()):
        return None
    return fitted(points, camera, pose_of(R, t), iterations=iterations)


def fitted(
    points: Correspondences, camera: Camera, T_sensor_target: RigidTransform, *, iterations: int
) -> Fit | None:
    """Return the pose with the least squared reprojection error near another; None if it leaves the view."""
    intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy)
    R, t = T_sensor_target.rotation.as_matrix(), T_sensor_target.translation
    R, t = refine(points.points_m, points.pixels, intrinsics, R, t, iterations)
    errors_px, information, _, before = reproject(points.points_m, points.pixels, intrinsics, R, t)
    return Fit(pose_of(R, t), errors_px, information) if before else None


@njit(cache=True, nogil=True)
def reproject(points, pixels, intrinsics, R, t):  # type: ignore[no-untyped-def]
    """Return errors, (N, 2), px, J^T J, J^T errors, and whether all points lie before the camera."""
    fx, fy, cx, cy = intrinsics
    information, gradient, row = np.zeros((6, 6)), np.zeros(6), np.empty(6)
    errors, by_place = np.empty(pixels.shape), np.zeros((2, 3))
    for n in range(points.shape[0]):
        q = points[n]
        p = R @ q + t
        if not p[2] > BEHIND_M:
            return errors, information, gradient, False
        u, v = p[0] / p[2], p[1] / p[2]
        errors[n, 0], errors[n, 1] = fx * u + cx - pixels[n, 0], fy * v + cy - pixels[n, 1]
        by_place[0, 0], by_place[0, 2] = fx / p[2], -fx * u / p[2]
        by_place[1, 1], by_place[1, 2] = fy / p[2], -fy * v / p[2]
        by_tau = by_place @ R
        for i in range(2):
            a = by_tau[i]
            row[0], row[1], row[2] = a[0], a[1], a[2]
            row[3], row[4], row[5] = (
                q[1] * a[2] - q[2] * a[1],
                q[2] * a[0] - q[0] * a[2],
                q[0] * a[1] - q[1] * a[0],
            )
            add_residual(information, gradient, row, errors[n, i], 1.0)
    return errors, information, gradient, True


@njit(cache=True, nogil=True)
def refine(points, pixels, intrinsics, R, t, iterations):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Return R and t after Gauss-Newton steps on the reprojection error."""
    for _ in range(iterations):
        _, information, gradient, before = reproject(points, pixels, intrinsics, R, t)
        if not before:
            break
        step = solve(information, gradient, 0.0)
        t = t + R @ step[:3]
        R = turned(R, step[3:])
        if np.abs(step).max() < SETTLED:
            break
    return R, t
