"""A pose from points and their pixels in the image: EPnP, its refinement, and its covariance.

Klionovska et al., Robotics 7(1), 2018, section 3.3.2, Eqs. 5 to 7; the solver is OpenCV's (Lepetit et
al., Int. J. Comput. Vis. 81, 2009). Pixels are undistorted, so the camera is a pinhole. The refinement
minimises the reprojection error by Gauss-Newton steps with the perturbation of ``normal_equations``.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_geometry.kernels import kernel
from rpod_pose.registration.lie_group import PoseArrays, Vector, in_sensor, in_target, stepped
from rpod_pose.registration.normal_equations import (
    UNKNOWNS,
    add_residual,
    held_step,
    information_of,
    no_sums,
)
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import pose_of
from rpod_schemas.types import Camera

CONVERGED = 1e-6
"""Step, m and rad, below which the refinement has converged. Numerics: a thousandth of any error of the
method."""
LEAST_HOLD = 1e-12
"""Prior information that the step is zero, 1/m2 or 1/rad2 times px2. Numerics: negligible, so that the
information can always be inverted."""
BEHIND_M = 1e-3
"""Least z of a point that is projected, m. Numerics: at smaller z its derivatives overflow."""
PRIOR_RESIDUALS = 4.0
"""Number of residuals for which the assumed noise counts. Hand: few points hardly determine their own
noise."""
WORST_CONDITION = 1e10
"""Largest condition number of the information that is inverted. Numerics: six digits of a double are
left."""


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Points of the model with their pixels in the image."""

    points_m: FloatArray
    """Points of the model, target axes, shape (N, 3)."""
    pixels: FloatArray
    """Undistorted column and row of the points, shape (N, 2)."""

    def __len__(self) -> int:
        return len(self.points_m)

    def without(self, number: int) -> "Correspondences":
        """Return the correspondences without one point."""
        kept = np.arange(len(self)) != number
        return Correspondences(self.points_m[kept], self.pixels[kept])

    @property
    def relief(self) -> float:
        """Extent of the points across their best plane over that along it: 0 if they are coplanar."""
        extents = np.linalg.svd(self.points_m - self.points_m.mean(axis=0), compute_uv=False)
        return float(extents[2] / extents[0]) if extents[0] > 0.0 else 0.0


@dataclass(frozen=True, eq=False)
class Fit:
    """A pose with its reprojection errors."""

    T_sensor_target: RigidTransform
    errors_px: FloatArray
    """Projected minus measured pixels, shape (N, 2)."""
    information: FloatArray
    """J^T J of the errors by (dtau, dtheta) in target axes, 1/px^2 to be scaled, shape (6, 6)."""

    @property
    def distances_px(self) -> FloatArray:
        """Length of each reprojection error, shape (N,)."""
        distances: FloatArray = np.sqrt((self.errors_px**2).sum(axis=1))
        return distances

    @property
    def rms_px(self) -> float:
        """Root mean square of the reprojection errors."""
        return float(np.sqrt((self.errors_px**2).sum(axis=1).mean()))

    def covariance(self, noise_px: float) -> FloatArray:
        """Return the covariance of (dp, dtheta) in the sensor's fixed axes (ICD section 1), shape (6, 6).

        It is s^2 (J^T J)^-1 with the standard deviation s of the errors, which is at least ``noise_px``. It
        is NaN if the points leave a motion undetermined.
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
    """Return the pose by EPnP after its refinement; None if it is not in front of the camera.

    Args:
        points: four or more, not in one plane.
        camera: camera matrix; the distortion is not used.
        iterations: largest number of Gauss-Newton steps; 0 for the pose of EPnP itself.
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
    pinhole = Pinhole(camera.fx, camera.fy, camera.cx, camera.cy)
    start = PoseArrays.of(T_sensor_target)
    R, t = refine(points.points_m, points.pixels, pinhole, start, iterations)
    errors_px, sums, before = reproject(points.points_m, points.pixels, pinhole, PoseArrays(R, t))
    return Fit(pose_of(R, t), errors_px, information_of(sums, 6)) if before else None


class Pinhole(NamedTuple):
    """A camera's matrix, px."""

    fx: float
    fy: float
    cx: float
    cy: float


class Reprojection(NamedTuple):
    """Reprojection of points of a model."""

    errors_px: FloatArray
    """Projected minus measured pixels, shape (N, 2)."""
    sums: FloatArray
    """Sums over the errors, with weight 1, shape (35,)."""
    before: bool
    """Whether all points lie in front of the camera; if not, the other fields are not complete."""


@kernel
def reproject(points: FloatArray, pixels: FloatArray, pinhole: Pinhole, pose: PoseArrays) -> Reprojection:
    """Return the reprojection of points at a pose.

    A pixel u = fx x / z + cx moves by (fx / z, 0, -fx x / z^2) times a step of the point in sensor axes, so
    that the residual's normal is minus that, turned into target axes; v likewise.

    Args:
        points: points of the model, target axes, shape (N, 3), m.
        pixels: measured pixels of the points, column and row, shape (N, 2).
        pinhole: the camera.
        pose: pose of the target.
    """
    sums, errors, R = no_sums(), np.empty(pixels.shape), pose.R
    for n in range(points.shape[0]):
        place = Vector(points[n, 0], points[n, 1], points[n, 2])
        p = in_sensor(R, place.x, place.y, place.z)
        x, y, z = p.x + pose.t[0], p.y + pose.t[1], p.z + pose.t[2]
        if not z > BEHIND_M:
            return Reprojection(errors, sums, False)
        u, v = x / z, y / z
        errors[n, 0] = pinhole.fx * u + pinhole.cx - pixels[n, 0]
        errors[n, 1] = pinhole.fy * v + pinhole.cy - pixels[n, 1]
        across = in_target(R, -pinhole.fx / z, 0.0, pinhole.fx * u / z)
        down = in_target(R, 0.0, -pinhole.fy / z, pinhole.fy * v / z)
        add_residual(sums, across, place, errors[n, 0], 1.0)
        add_residual(sums, down, place, errors[n, 1], 1.0)
    return Reprojection(errors, sums, True)


@kernel
def refine(
    points: FloatArray, pixels: FloatArray, pinhole: Pinhole, start: PoseArrays, iterations: int
) -> PoseArrays:
    """Return the pose after Gauss-Newton steps on the reprojection error.

    Args:
        points: points of the model, target axes, shape (N, 3), m.
        pixels: measured pixels of the points, column and row, shape (N, 2).
        pinhole: the camera.
        start: initial pose.
        iterations: largest number of steps; the first step below ``CONVERGED`` is the last.
    """
    pose, hold = start, np.full(UNKNOWNS, LEAST_HOLD)
    for _ in range(iterations):
        seen = reproject(points, pixels, pinhole, pose)
        if not (seen.before and np.isfinite(seen.sums).all()):
            break
        step = held_step(seen.sums, hold)
        pose = stepped(pose, step[:6])
        if np.abs(step).max() < CONVERGED:
            break
    return pose
