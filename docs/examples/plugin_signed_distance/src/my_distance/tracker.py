"""Gauss-Newton steps that bring the measured points onto the target's surface."""

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.rays import RayGrid
from rpod_pose.belief import Belief, doubtful
from rpod_pose.ports import Registration
from rpod_schemas.types import Source


class MyDistance:
    def __init__(self, config, task):
        self._scales_m, self._radius_m = config.scales_m, task.target.radius_m
        field = task.target.require_field()
        self._at = lambda p: ((p - field.origin_m) / field.spacing_m).T
        slopes = np.gradient(field.values, field.spacing_m)
        self._values = [np.asarray(grid, np.float32) for grid in (field.values, *slopes)]

    def track(self, measurement, T_sensor_target):
        rays = RayGrid.pinhole(measurement.camera).directions[::4, ::4]
        points_m = (rays / rays[..., 2:] * measurement.depth_m[::4, ::4, None]).reshape(-1, 3)
        near = np.linalg.norm(points_m - T_sensor_target.translation, axis=1) < 1.1 * self._radius_m
        if near.sum() < 50:
            return Registration.none(Source.PMD_DEPTH, f"{near.sum()} points near the target, limit 50")
        points_m, pose = points_m[near].astype(float), T_sensor_target
        for scale_m in self._scales_m:
            p = pose.inv().apply(points_m)
            d, *n = (map_coordinates(g, self._at(p), order=1, mode="nearest") for g in self._values)
            rows = np.hstack((-np.transpose(n), np.cross(np.transpose(n), p)))
            weight = (scale_m**2 / (scale_m**2 + d**2)) ** 2
            information = np.einsum("n,ni,nj->ij", weight, rows, rows) + 1e-3 * np.eye(6)
            step = np.linalg.solve(information, -np.einsum("n,ni,n->i", weight, rows, d))
            pose = pose * RigidTransform.from_components(step[:3], Rotation.from_rotvec(step[3:]))
        inlier = np.abs(d) < scale_m
        turn = np.kron(np.eye(2), pose.rotation.as_matrix())  # neighbours err alike: 120 count
        covariance = turn @ np.linalg.inv(information) @ turn.T * 0.02**2 * len(d) / 120 + 1e-5 * np.eye(6)
        share = inlier.mean()
        belief = (
            Belief() if share > 0.6 else doubtful(f"{share:.0%} of the points on the surface, limit 60 %")
        )
        cost_m2, count = float((d[inlier] ** 2).mean()), int(inlier.sum())
        return Registration(
            Source.PMD_DEPTH, pose, belief, cost_m2, count, float(share), covariance=covariance
        )
