"""A tracker that registers depth points in the target's distance field, and the normal equations of points.

The residual, its derivatives and the loop are those of ``registration.field_alignment``. No correspondences
are searched, and the Geman-McClure scale narrows from step to step.
"""

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_pose.pmd.depth_result import Progress, registration_of, size_of
from rpod_pose.pmd.depth_view import usable_image
from rpod_pose.ports import Registration
from rpod_pose.registration.distance_field import field_arrays
from rpod_pose.registration.field_alignment import (
    FieldEvidence,
    FieldProblem,
    Points,
    field_equations,
    field_fit,
)
from rpod_pose.registration.gauss_newton import Linear, State
from rpod_pose.registration.lie_group import PoseArrays, step_length_m
from rpod_pose.registration.normal_equations import NormalEquations
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.methods import SignedDistanceConfig
from rpod_schemas.poses import pose_of
from rpod_schemas.types import PmdFrame, Source
from rpod_target import Target


def measured_equations(
    target: Target, points_m: FloatArray, T_sensor_target: RigidTransform, scale_m: float
) -> NormalEquations:
    """Return the normal equations of measured points in the target's distance field.

    Args:
        target: target with a distance field.
        points_m: measured points, sensor axes, shape (N, 3).
        T_sensor_target: pose to linearise at.
        scale_m: Geman-McClure scale, above 0.
    """
    problem = FieldProblem(Points.equal(points_m), field_arrays(target), np.array([scale_m]))
    return _equations(field_equations(problem, State(PoseArrays.of(T_sensor_target), 0.0), 0))


def _equations(linear: Linear[FieldEvidence]) -> NormalEquations:
    found = linear.evidence
    return NormalEquations.of(
        linear.sums, weight=found.weight, squares_m2=found.squares_m2, inliers=found.inliers
    )


class SignedDistanceTracker:
    """Registers depth images in the target's distance field: ports.Tracker[PmdFrame].

    Args:
        config: parameters of the tracker.
        target: the target to track.

    Raises:
        rpod_target.TargetError: the target has no distance field.
    """

    def __init__(self, config: SignedDistanceConfig, target: Target) -> None:
        self._tuning, self._target = config.tuning, target
        target.require_field()

    def track(self, measurement: PmdFrame, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration from a predicted pose, or the reason why the frame gives none."""
        tuning = self._tuning
        image = usable_image(measurement, tuning.image)
        if isinstance(image, str):
            return Registration.none(Source.PMD_DEPTH, image)
        points_m = image.points(tuning.points)
        scales_m = np.geomspace(*tuning.scales_m(size_of(self._target, image)), tuning.iterations)
        problem = FieldProblem(Points.equal(points_m), field_arrays(self._target), scales_m)
        fit = field_fit(problem, PoseArrays.of(T_sensor_target))
        step_m = step_length_m(fit.step[:6], self._target.radius_m)
        T = pose_of(*fit.state.pose)
        progress = Progress(T, _equations(fit.linear), len(points_m), step_m, fit.steps)
        return registration_of(progress, image, self._target, tuning)
