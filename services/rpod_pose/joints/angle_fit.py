"""Angle of a joint at a known pose: the posterior within its limits from the distances of a frame's points.

Each point belongs to the nearer of two surfaces: the joint's parts at an angle, or the rest of the target.
The posterior is computed on a grid over all possible angles, and then on a finer grid around its maximum. So
the standard deviation is large if the frame does not determine the angle, or if it is ambiguous. The length
by which all ranges are too long, for example by a camera's wiggling, is estimated from all points between the
two steps.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import radians, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.kernels import kernel
from rpod_pose.belief import Angle
from rpod_pose.registration.distance_field import FieldArrays, field_arrays, field_at
from rpod_pose.registration.lie_group import Vector
from rpod_schemas.arrays import MAD_TO_SIGMA, FloatArray
from rpod_target import Joint, Target

STEP_RAD = radians(1.0)
"""Step of the grid over all angles: half of the required accuracy of a first angle. Numerics: a finer grid
follows."""
FINE_NODES = 61
"""Number of nodes of the grid around the maximum. Numerics: they are 0.13 standard deviations apart."""
SPREAD = 4.0
"""Half width of a grid, in standard deviations of an expected angle or of the first posterior. Physics: one
in 16,000 normal errors is larger."""
INLIER = 3.0
"""Geman-McClure scale over the residuals' standard deviation. Physics: one in 370 normal errors is larger."""
COUNTED = 400.0
"""Largest number of residuals that count as independent. Hand: that of
``JointDepthConfig.effective_points``."""
WIDE_RAD, NARROW, STEPS = radians(15.0), 0.05, 12
"""Steps in which pose and angles are fitted together: the first Geman-McClure scale as an angle of the joint,
the ratio of the last to the first scale, and their number. Numerics: half of ``methods.STEP_RAD``, narrowed
by a quarter in each step."""
WEAK = 1e-4
"""Share of the mean information that is added to that of each unknown, so that each is determined. Numerics:
it changes a determined step by one part in 10,000."""


class Turns(NamedTuple):
    """Angles of a joint in the form that the kernel takes."""

    matrices: FloatArray
    """Rotations from target axes to the parts' axes at the angle 0, shape (A, 3, 3)."""
    origin_m: FloatArray
    """A point on the axis, shape (3,)."""


@kernel
def turned_costs(
    points: FloatArray, others_m: FloatArray, turns: Turns, field: FieldArrays, scale: float
) -> FloatArray:
    """Return the sum of the Geman-McClure losses of the points at each angle, shape (A,), m2.

    Args:
        points: points, target axes, shape (N, 3), m.
        others_m: distances from the rest of the target, shape (N,).
        turns: angles.
        field: distance field of the joint's parts at the angle 0.
        scale: Geman-McClure scale, m.
    """
    c2, origin, costs = scale * scale, turns.origin_m, np.zeros(len(turns.matrices))
    for a in range(len(turns.matrices)):
        R = turns.matrices[a]
        for n in range(len(points)):
            x, y, z = points[n, 0] - origin[0], points[n, 1] - origin[1], points[n, 2] - origin[2]
            place = Vector(
                R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + origin[0],
                R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + origin[1],
                R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + origin[2],
            )
            d = min(others_m[n], field_at(field, place).distance)
            costs[a] += d * d * c2 / (c2 + d * d)
    return costs


@kernel
def looked_up(points: FloatArray, field: FieldArrays) -> FloatArray:
    """Return distance, m, and gradient of a field, shape (N, 4), at points, target axes, shape (N, 3)."""
    found = np.empty((len(points), 4))
    for n in range(len(points)):
        distance, slope = field_at(field, Vector(points[n, 0], points[n, 1], points[n, 2]))
        found[n, 0], found[n, 1], found[n, 2], found[n, 3] = distance, slope.x, slope.y, slope.z
    return found


@dataclass(frozen=True, eq=False)
class _Surface:
    """Distances of points from the surface of a target at given angles."""

    distance_m: FloatArray
    """Distance of each point, shape (N,)."""
    normals: FloatArray
    """Gradients of the distance, target axes, shape (N, 3)."""
    by_angle: FloatArray
    """Derivative of each distance with respect to the joint's angle, m/rad, shape (N,); 0 for points that are
    not on its parts."""


@dataclass(frozen=True, eq=False)
class Aligned:
    """Pose and angles that were fitted together."""

    T_sensor_target: RigidTransform
    angles: Mapping[str, Angle]
    loss_m2: float
    """Mean Geman-McClure loss of the points, m2."""


class JointSolver:
    """Estimates the angles of a target's joints from the points of a frame."""

    def __init__(self, target: Target) -> None:
        assert target.fixed is not None  # noqa: S101 - a target with joints
        self.joints = target.joints
        self._fixed = field_arrays(target.fixed)
        self._moving = {joint.name: field_arrays(joint.moving) for joint in target.joints}

    def angles(
        self, points_m: FloatArray, T_sensor_target: RigidTransform, expected: Mapping[str, Angle]
    ) -> dict[str, Angle]:
        """Return the angle of each joint at a pose; the other joints have their expected angles meanwhile.

        Args:
            points_m: measured points, sensor axes, shape (N, 3).
            T_sensor_target: the pose.
            expected: prior of each joint's angle, by name.
        """
        if not len(points_m):
            return dict(expected)
        at = dict(expected)
        for joint in self.joints:
            at[joint.name] = self._angle(points_m, T_sensor_target, joint, at)
        return at

    def aligned(
        self, points_m: FloatArray, T_sensor_target: RigidTransform, expected: Mapping[str, Angle]
    ) -> "Aligned":
        """Return pose and angles that are fitted together, from a pose near the solution.

        If the parts of a joint are most of the target, alternate fits of pose and angle converge slowly along
        a narrow valley. Therefore each step is a least-squares step of pose and angles together, with
        Geman-McClure weights whose scale narrows.
        The loop is not that of ``registration.gauss_newton``, whose sums have seven unknowns: here each joint
        adds one.

        Args:
            points_m: measured points, sensor axes, shape (N, 3).
            T_sensor_target: the pose to start from.
            expected: the angles to start from, with their standard deviations.
        """
        pose, at = T_sensor_target, dict(expected)
        widest_m = WIDE_RAD * max(joint.lever_m for joint in self.joints)
        loss_m2 = np.inf
        for scale_m in np.geomspace(widest_m, NARROW * widest_m, STEPS):
            places_m = pose.inv().apply(points_m)
            rows, distance_m = self._rows(places_m, at)
            d2, c2 = distance_m**2, scale_m**2
            weights = (c2 / (c2 + d2)) ** 2
            loss_m2 = float((d2 * c2 / (c2 + d2)).mean())
            information = (rows * weights[:, None]).T @ rows
            variance_m2 = float(weights @ d2) / max(float(weights.sum()), 1e-9)
            for number, joint in enumerate(self.joints, 6):
                information[number, number] += variance_m2 / expected[joint.name].sigma_rad ** 2
            information += WEAK * np.diag(np.diag(information) + 1e-12)
            step = np.linalg.solve(information, -rows.T @ (weights * distance_m))
            step[:3] = np.clip(step[:3], -widest_m, widest_m)
            step[3:] = np.clip(step[3:], -WIDE_RAD, WIDE_RAD)
            turn = Rotation.from_rotvec(step[3:6])
            pose = pose * RigidTransform.from_components(step[:3], turn)
            for number, joint in enumerate(self.joints, 6):
                angle = at[joint.name]
                angle_rad = float(np.clip(angle.angle_rad + step[number], *joint.limits_rad))
                at[joint.name] = Angle(angle_rad, angle.sigma_rad)
        return Aligned(pose, at, loss_m2)

    def _rows(self, places_m: FloatArray, at: Mapping[str, Angle]) -> tuple[FloatArray, FloatArray]:
        """Return the derivatives of each distance for pose and angles, (N, 6 + joints), and the distances."""
        seen = [self._surface(places_m, self.joints, at, joint) for joint in self.joints]
        normals = seen[0].normals
        by_angle = [each.by_angle for each in seen]
        return np.column_stack((-normals, np.cross(normals, places_m), *by_angle)), seen[0].distance_m

    def _angle(
        self, points_m: FloatArray, pose: RigidTransform, joint: Joint, at: Mapping[str, Angle]
    ) -> Angle:
        expected, sensor_m = at[joint.name], pose.inv().translation
        there_m = pose.inv().apply(points_m)
        rays = (there_m - sensor_m) / np.linalg.norm(there_m - sensor_m, axis=1)[:, None]
        others = [other for other in self.joints if other is not joint]
        lever_m, angle_rad, bias_m = joint.lever_m, expected.angle_rad, 0.0
        sigma_rad, scale_m = expected.sigma_rad, 0.0
        for fine in (False, True):
            places_m = there_m - bias_m * rays
            others_m = self._surface(places_m, others, at).distance_m
            angles = _grid(joint, angle_rad, sigma_rad, fine=fine)
            scale_m = max(INLIER * scale_m, lever_m * (angles[1] - angles[0]))
            costs = turned_costs(places_m, others_m, _turns(joint, angles), self._moving[joint.name], scale_m)
            best = angles[int(costs.argmin())]
            seen = self._surface(places_m, self.joints, {**at, joint.name: Angle(float(best), 0.0)}, joint)
            near = np.abs(seen.distance_m) < scale_m
            scale_m = max(
                MAD_TO_SIGMA * float(np.median(np.abs(seen.distance_m[near]))) if near.any() else 0.0, 1e-4
            )
            if not fine:
                bias_m = _bias_m(seen, rays, near)
            counted = min(1.0, COUNTED / max(int(near.sum()), 1))
            logs = -0.5 * counted * costs / scale_m**2
            logs -= 0.5 * ((angles - expected.angle_rad) / expected.sigma_rad) ** 2
            weights = np.exp(logs - logs.max())
            weights /= weights.sum()
            angle_rad = float(angles[int(logs.argmax())])
            spread = float(np.sqrt(weights @ (angles - angle_rad) ** 2))
            sigma_rad = max(spread, (angles[1] - angles[0]) / sqrt(12.0))
        return Angle(angle_rad, sigma_rad)

    def _surface(
        self,
        places_m: FloatArray,
        joints: Sequence[Joint],
        at: Mapping[str, Angle],
        of: Joint | None = None,
    ) -> _Surface:
        """Return distances of points from the target; the derivatives are those for the joint ``of``."""
        found, by_angle = looked_up(places_m, self._fixed), np.zeros(len(places_m))
        for joint in joints:
            motion = joint.turned(at[joint.name].angle_rad)
            other = looked_up(motion.inv().apply(places_m), self._moving[joint.name])
            other[:, 1:] = motion.rotation.apply(other[:, 1:])
            nearer = other[:, 0] < found[:, 0]
            found[nearer] = other[nearer]
            moves = np.cross(joint.axis, places_m - joint.origin_m)
            by_angle[nearer] = -(other[:, 1:] * moves).sum(axis=1)[nearer] if joint is of else 0.0
        return _Surface(found[:, 0], found[:, 1:], by_angle)

    def considered(
        self,
        points_m: FloatArray,
        T_sensor_target: RigidTransform,
        covariance: FloatArray,
        angles: Mapping[str, Angle],
    ) -> tuple[FloatArray, dict[str, Angle]]:
        """Return a pose's covariance with the errors of the angles, and the angles with those of the pose.

        The pose was estimated as if the angles were known, and the angles as if the pose were known. So each
        has an additional error: the error of the other times the derivative in least squares.

        Args:
            points_m: measured points, sensor axes, shape (N, 3).
            T_sensor_target: the pose.
            covariance: covariance of its (dp, dtheta) for known angles, sensor axes, shape (6, 6).
            angles: angles with their standard deviations for a known pose.
        """
        places_m = T_sensor_target.inv().apply(points_m)
        turn = np.kron(np.eye(2), T_sensor_target.rotation.as_matrix())
        there, whole = turn.T @ covariance @ turn, covariance.copy()
        wider = dict(angles)
        for joint in self.joints:
            seen = self._surface(places_m, self.joints, angles, joint)
            near = np.abs(seen.distance_m) < 0.1 * joint.lever_m
            by_pose = np.hstack((-seen.normals, np.cross(seen.normals, places_m)))[near]
            by_angle, sigma_rad = seen.by_angle[near], angles[joint.name].sigma_rad
            mixed, squares = by_pose.T @ by_angle, float(by_angle @ by_angle)
            if squares == 0.0:
                continue
            information = by_pose.T @ by_pose
            information += WEAK * np.diag(np.diag(information) + 1e-12)
            shift = turn @ np.linalg.solve(information, mixed)
            whole += sigma_rad**2 * np.outer(shift, shift)
            slope = mixed / squares
            least, greatest = joint.limits_rad
            sigma_rad = min(
                sqrt(sigma_rad**2 + float(slope @ there @ slope)), (greatest - least) / sqrt(12.0)
            )
            wider[joint.name] = Angle(angles[joint.name].angle_rad, sigma_rad)
        return whole, wider


def unknown(joint: Joint) -> Angle:
    """Return the uniform prior of a joint's angle between its limits."""
    least, greatest = joint.limits_rad
    return Angle(0.5 * (least + greatest), (greatest - least) / sqrt(12.0))


def _grid(joint: Joint, angle_rad: float, sigma_rad: float, *, fine: bool) -> FloatArray:
    least, greatest = joint.limits_rad
    least, greatest = (
        max(least, angle_rad - SPREAD * sigma_rad),
        min(greatest, angle_rad + SPREAD * sigma_rad),
    )
    greatest = max(greatest, least + 1e-6)
    nodes = FINE_NODES if fine else int((greatest - least) / STEP_RAD) + 2
    return np.linspace(least, greatest, max(nodes, 9))


def _turns(joint: Joint, angles: FloatArray) -> Turns:
    back = Rotation.from_rotvec(-angles[:, None] * joint.axis)
    return Turns(np.ascontiguousarray(back.as_matrix()), joint.origin_m)


def _bias_m(seen: _Surface, rays: FloatArray, near: NDArray[np.bool_]) -> float:
    """Return the length, m, by which all ranges are too long, from the points near the surface."""
    along = (seen.normals * rays).sum(axis=1)[near]
    squares = float(along @ along)
    return float(along @ seen.distance_m[near]) / squares if squares > 0.0 else 0.0
