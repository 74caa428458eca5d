"""A pose from points and their places in the image: EPnP, its refinement, what it can be trusted with.

Klionovska et al., Robotics 7(1), 2018, section 3.3.2, Eqs. 5 to 7; the solver is OpenCV's (Lepetit et
al., Int. J. Comput. Vis. 81, 2009). Places are straightened, so the camera is a pinhole. The refinement
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

SETTLED = 1e-6
"""A step of less, m and rad, ends the refinement."""
LEAST_HOLD = 1e-12
"""Information that no step is needed, 1/m2 or 1/rad2 times px2: next to none."""
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
    """Where points of a model are imaged."""

    errors_px: FloatArray
    """From where they were seen to where the pose has them, shape (N, 2)."""
    sums: FloatArray
    """Of the errors, weight 1, shape (35,)."""
    before: bool
    """Whether all points lie before the camera; else the others are not filled in."""


@kernel
def reproject(points: FloatArray, pixels: FloatArray, pinhole: Pinhole, pose: PoseArrays) -> Reprojection:
    """Return how points reproject at a pose.

    A pixel u = fx x / z + cx moves by (fx / z, 0, -fx x / z^2) times a step of the point in sensor axes, so
    that the residual's normal is minus that, turned into target axes; v likewise.

    Args:
        points: target axes, shape (N, 3), m.
        pixels: where they were seen, column and row, shape (N, 2).
        pinhole: the camera.
        pose: of the target.
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
    """Return the pose after at most so many Gauss-Newton steps on the reprojection error.

    Args:
        points: target axes, shape (N, 3), m.
        pixels: where they were seen, column and row, shape (N, 2).
        pinhole: the camera.
        start: pose to begin with.
        iterations: most steps; fewer where a step is shorter than ``SETTLED``.
    """
    pose, hold = start, np.full(UNKNOWNS, LEAST_HOLD)
    for _ in range(iterations):
        seen = reproject(points, pixels, pinhole, pose)
        if not (seen.before and np.isfinite(seen.sums).all()):
            break
        step = held_step(seen.sums, hold)
        pose = stepped(pose, step[:6])
        if np.abs(step).max() < SETTLED:
            break
    return pose
