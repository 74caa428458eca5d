"""Depth points in the target's distance field: the residual, its Gauss-Newton steps, and a tracker of them.

A measured point p, in sensor axes, lies at q = R^T (p - t) in target axes; its residual is the signed
distance d(q), trilinear in the grid, with the derivatives (-grad d, grad d x q) by the right perturbation
R <- R Exp(dtheta), t <- t + R dtau, ordered (dtau, dtheta). No correspondences are searched. Weights are
Geman-McClure's, (c^2 / (c^2 + d^2))^2, with the scale c annealed from wide to narrow.
"""

import numpy as np
from numba import njit
from scipy.spatial.transform import RigidTransform

from rpod_estimator.ports import Registration
from rpod_estimator.tracking.conclusion import Progress, conclude
from rpod_estimator.tracking.depth_view import usable_image
from rpod_estimator.tracking.normal_equations import (
    NormalEquations,
    add_residual,
    moved,
    solve,
    step_length_m,
)
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd_methods import SignedDistanceConfig
from rpod_schemas.types import Float32Array, PmdFrame, Source
from rpod_target import Target

AWAY = 0.5
"""A face turned from the line of sight by more than this cosine cannot have been measured."""


@njit(cache=True, nogil=True)
def distance_and_gradient(x, y, z, values):  # type: ignore[no-untyped-def]
    """Return the trilinear distance and its gradient a cell, at a place in cells of the field.

    Outside the grid, both are those of its border.
    """
    nx, ny, nz = values.shape
    cx = min(max(x, 0.0), nx - 1.001)
    cy = min(max(y, 0.0), ny - 1.001)
    cz = min(max(z, 0.0), nz - 1.001)
    i, j, k = int(cx), int(cy), int(cz)
    u, v, w = cx - i, cy - j, cz - k
    c000, c001 = values[i, j, k], values[i, j, k + 1]
    c010, c011 = values[i, j + 1, k], values[i, j + 1, k + 1]
    c100, c101 = values[i + 1, j, k], values[i + 1, j, k + 1]
    c110, c111 = values[i + 1, j + 1, k], values[i + 1, j + 1, k + 1]
    c00, c01 = c000 + u * (c100 - c000), c001 + u * (c101 - c001)
    c10, c11 = c010 + u * (c110 - c010), c011 + u * (c111 - c011)
    c0, c1 = c00 + v * (c10 - c00), c01 + v * (c11 - c01)
    across_0, across_1 = (
        c100 - c000 + v * (c110 - c010 - c100 + c000),
        c101 - c001 + v * (c111 - c011 - c101 + c001),
    )
    return (
        c0 + w * (c1 - c0),
        across_0 + w * (across_1 - across_0),
        c10 - c00 + w * (c11 - c01 - c10 + c00),
        c1 - c0,
    )


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
def turned(R, rotation_vector):  # type: ignore[no-untyped-def]
    """Return R Exp(rotation_vector): Rodrigues' formula, since scipy's rotations do not compile."""
    angle = np.sqrt((rotation_vector**2).sum())
    a, b = 1.0, 0.5
    if angle > 1e-6:
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / (angle * angle)
    x, y, z = rotation_vector
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return R @ (np.eye(3) + a * K + b * (K @ K))


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


def field_arrays(target: Target) -> tuple[FloatArray, float, Float32Array]:
    """Return origin, spacing and values of a target's distance field, as the kernels take them."""
    field = target.require_field()
    return field.origin_m, field.spacing_m, field.values


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
            return Registration(Source.PMD_DEPTH, reason=image)
        points_m = image.points(config.points)
        progress = Progress(T_sensor_target)
        for scale_m in np.geomspace(config.scale_m, config.final_scale_m, config.iterations):
            T = progress.T_sensor_target
            sums = measured_equations(self._target, points_m, T, scale_m)
            step = sums.step()
            step_m = step_length_m(step, self._target.radius_m)
            progress = Progress(moved(T, step), sums, len(points_m), step_m, progress.iterations + 1)
        return conclude(progress, image, self._target, config)
