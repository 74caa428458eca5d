"""Depth points in the target's distance field: the residual, its Gauss-Newton steps, and a tracker of them.

A measured point p, in sensor axes, lies at q = R^T (p - t) in target axes; its residual is the signed
distance d(q), trilinear in the grid, with the derivatives (-grad d, grad d x q) by the right perturbation
R <- R Exp(dtheta), t <- t + R dtau, ordered (dtau, dtheta). No correspondences are searched. Weights are
Geman-McClure's, (c^2 / (c^2 + d^2))^2, with the scale c annealed from wide to narrow.
"""

import numpy as np
from numba import njit
from scipy.spatial.transform import RigidTransform

from rpod_pose.pmd.depth_result import Progress, conclude
from rpod_pose.pmd.depth_view import usable_image
from rpod_pose.ports import Registration
from rpod_pose.registration.distance_field import distance_and_gradient, field_arrays
from rpod_pose.registration.lie_group import moved, step_length_m, turned
from rpod_pose.registration.normal_equations import NormalEquations, add_residual, solve
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd_methods import SignedDistanceConfig
from rpod_schemas.types import PmdFrame, Source
from rpod_target import Target

AWAY = 0.5
"""A face turned from the line of sight by more than this cosine cannot have been measured."""


@njit(cache=True, nogil=True)
def field_equations(points, R, t, field, scale):  # type: ignore[no-untyped-def]
    """Return the sums of ``NormalEquations`` and the mean Geman-McClure cost, m2.

    Args:
        points: measured points in sensor axes, (N, 3).
        R: of the target in the sensor, (3, 3).
        t: of the target in the sensor, (3,), m.
        field: ``field_arrays`` of the target.
        scale: Geman-McClure scale, m.
    """
    origin, spacing, values = field
    information, gradient, row = np.zeros((6, 6)), np.zeros(6), np.empty(6)
    weights, squares, robust, inliers, c2 = 0.0, 0.0, 0.0, 0, scale * scale
    for n in range(points.shape[0]):
        px, py, pz = points[n]
        dx, dy, dz = px - t[0], py - t[1], pz - t[2]
        x = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
        y = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
        z = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
        distance, gx, gy, gz = distance_and_gradient(
            (x - origin[0]) / spacing, (y - origin[1]) / spacing, (z - origin[2]) / spacing, values
        )
        gx, gy, gz = gx / spacing, gy / spacing, gz / spacing
        along = (
            gx * (R[0, 0] * px + R[1, 0] * py + R[2, 0] * pz)
            + gy * (R[0, 1] * px + R[1, 1] * py + R[2, 1] * pz)
            + gz * (R[0, 2] * px + R[1, 2] * py + R[2, 2] * pz)
        )
        if along > AWAY * np.sqrt(px * px + py * py + pz * pz):
            robust += c2
            continue
        d2 = distance * distance
        weight = (c2 / (c2 + d2)) ** 2
        row[0], row[1], row[2] = -gx, -gy, -gz
        row[3], row[4], row[5] = gy * z - gz * y, gz * x - gx * z, gx * y - gy * x
        add_residual(information, gradient, row, distance, weight)
        weights += weight
        robust += c2 * d2 / (c2 + d2)
        if d2 < c2:
            inliers += 1
            squares += d2
    return information, gradient, weights, squares, inliers, robust / max(points.shape[0], 1)


@njit(cache=True, nogil=True)
def refine(points, R, t, field, scales):  # type: ignore[no-untyped-def]
    """Return R, t and the mean Geman-McClure cost, m2, after one step for each scale."""
    for scale in scales:
        information, gradient, weight, _, _, _ = field_equations(points, R, t, field, scale)
        step = solve(information, gradient, weight)
        t = t + R @ step[:3]
        R = turned(R, step[3:])
    cost = field_equations(points, R, t, field, scales[-1])[5]
    return R, t, cost


def measured_equations(
    target: Target, points_m: FloatArray, T_sensor_target: RigidTransform, scale_m: float
) -> NormalEquations:
    """Return the normal equations of measured points, shape (N, 3), sensor axes."""
    R, t = T_sensor_target.rotation.as_matrix(), T_sensor_target.translation
    return NormalEquations(*field_equations(points_m, R, t, field_arrays(target), scale_m)[:5])


class SignedDistanceTracker:
    """Registers depth images in the target's distance field: ports.Tracker[PmdFrame].

    Raises:
        rpod_target.TargetError: the target has no distance field.
    """

    def __init__(self, config: SignedDistanceConfig, target: Target) -> None:
        self._config, self._target = config, target
        target.require_field()

    def track(self, measurement: PmdFrame, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration from a predicted pose, or the reason why there is none."""
        config = self._config
        image = usable_image(measurement, config.image)
        if isinstance(image, str):
            return Registration.none(Source.PMD_DEPTH, image)
        points_m = image.points(config.points)
        progress = Progress(T_sensor_target)
        for scale_m in np.geomspace(config.scale_m, config.final_scale_m, config.iterations):
            T = progress.T_sensor_target
            sums = measured_equations(self._target, points_m, T, scale_m)
            step = sums.step()
            step_m = step_length_m(step, self._target.radius_m)
            progress = Progress(moved(T, step), sums, len(points_m), step_m, progress.iterations + 1)
        return conclude(progress, image, self._target, config)
