"""Angle of a joint at a known pose: the posterior over its limits by the distances of a frame's points.

Each point belongs to the nearer of two surfaces, the joint's parts at an angle and all else of the target.
The posterior is computed on a grid over all that the angle may be, then on a finer one around its greatest
value, so that an angle that the frame leaves open, or ambiguous, has a large standard deviation. A length
by which all ranges are too long, such as a camera's wiggling, is estimated from all points in between.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import radians, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.kernels import kernel
from rpod_pose.ports import Angle
from rpod_pose.registration.distance_field import FieldArrays, field_arrays, field_at
from rpod_pose.registration.lie_group import Vector
from rpod_schemas.arrays import MAD_TO_SIGMA, FloatArray
from rpod_target import Joint, Target

STEP_RAD = radians(1.0)
"""Step of the grid over all angles: half of the accuracy that is wanted of a first angle. Numerics: a finer
grid over these angles follows."""
FINE_NODES = 61
"""Nodes of the grid around the greatest value. Numerics: they are 0.13 standard deviations apart."""
SPREAD = 4.0
"""Standard deviations of an expected angle, and of the first posterior, that a grid covers to each side.
Physics: one in 16,000 normal errors is larger."""
INLIER = 3.0
"""Geman-McClure scale over the residuals' standard deviation. Physics: one in 370 normal errors is larger."""
COUNTED = 400.0
"""Largest number of residuals that count as independent. Hand: that of
``JointDepthConfig.effective_points``."""
WIDE_RAD, NARROW, STEPS = radians(15.0), 0.05, 12
"""Steps in which pose and angles are fitted together: the first Geman-McClure scale as an angle of the joint,
the last one over it, and their number. Numerics: half of ``methods.STEP_RAD``, narrowed by a quarter a
step."""
WEAK = 1e-4
"""Share of the mean information that is added to that of each unknown, so that none is undetermined.
Numerics: it changes a step that is determined by one part in 10,000."""


class Turns(NamedTuple):
    """Angles of a joint, as the kernel takes them."""

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
    """Return distance, m, and gradient of a field at points, (N, 3), target axes, shape (N, 4)."""
    found = np.empty((len(points), 4))
    for n in range(len(points)):
        distance, slope = field_at(field, Vector(points[n, 0], points[n, 1], points[n, 2]))
        found[n, 0], found[n, 1], found[n, 2], found[n, 3] = distance, slope.x, slope.y, slope.z
    return found


@dataclass(frozen=True, eq=False)
class _Surface:
    """Points against the surface of a target at given angles."""

    distance_m: FloatArray
    """Distance of each point, shape (N,)."""
    normals: FloatArray
    """Gradients of the distance, target axes, shape (N, 3)."""
    by_angle: FloatArray
    """Derivative of each distance by the joint's angle, m/rad, shape (N,); 0 for points of the rest."""


@dataclass(frozen=True, eq=False)
class Aligned:
    """Pose and angles that were fitted together."""

    T_sensor_target: RigidTransform
    angles: Mapping[str, Angle]
    loss_m2: float
    """Mean Geman-McClure loss of the points, m2."""


class JointSolver:
    """Finds the angles of a target's joints in the points of a frame."""

    def __init__(self, target: Target) -> None:
        assert target.fixed is not None  # noqa: S101 - a target with joints
        self.joints = target.joints
        self._fixed = field_arrays(target.fixed)
        self._moving = {joint.name: field_arrays(joint.moving) for joint in target.joints}

    def angles(
        self, points_m: FloatArray, T_sensor_target: RigidTransform, expected: Mapping[str, Angle]
    ) -> dict[str, Angle]:
        """Return the angle of each joint at a pose; with several joints, each with the others as expected.

        Args:
            points_m: measured points, sensor axes, shape (N, 3).
            T_sensor_target: the pose.
            expected: what is known of each joint's angle before.
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

        Where the parts of a joint are most of the target, fitting the one with the other fixed leads along a
        narrow valley. Each step is that of least squares by pose and angles, with Geman-McClure weights whose
        scale narrows. The loop is not that of ``registration.gauss_newton``, whose sums have seven unknowns:
        here each joint adds one.

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
        """Return the derivatives of each distance by pose and angles, (N, 6 + joints), and the distances."""
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
        """Return points against the fixed parts and those of joints; ``of`` is that of the derivatives."""
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

        A pose was found with the angles as if they were known, and an angle with the pose: each shifts by
        the other's error times its derivative in least squares.

        Args:
            points_m: measured points, sensor axes, shape (N, 3).
            T_sensor_target: the pose.
            covariance: its covariance of (dp, dtheta), sensor axes, for known angles, shape (6, 6).
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
    """Return the angle of a joint of which only the limits are known."""
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
    """Return the length by which all ranges are too long, by the points near the surface."""
    along = (seen.normals * rays).sum(axis=1)[near]
    squares = float(along @ along)
    return float(along @ seen.distance_m[near]) / squares if squares > 0.0 else 0.0
