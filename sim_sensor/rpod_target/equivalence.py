"""Attitudes of a target that no measurement distinguishes, and errors modulo these.

An exact symmetry makes turned attitudes equivalent. Where every turn about an axis is a symmetry, the angle
about this axis is free: no measurement determines it, and no value of it is an error. Two such axes make a
sphere, whose whole attitude is free.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import pi, sqrt
from typing import Self

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import pose_error

FREE_SIGMA_RAD = pi / sqrt(3.0)
"""Standard deviation of an angle that is uniform over a turn: 104 deg."""
_SAME = 0.02
"""Largest difference between the components of two turns, or directions, that count as equal; files round
axes."""
_MOST = 60
"""Largest number of turns: the largest finite group without an axis of a high order, an icosahedron's."""
_ROUND = 24
"""Least order of an exact symmetry that counts as continuous: a polygon of so many sides is within 0.9 % of a
circle's radius, and all that can be known is the angle within 15 deg."""


@dataclass(frozen=True)
class Symmetry:
    """A rotation about an axis through the target's origin that maps it onto itself, nearly or exactly."""

    axis: tuple[float, float, float]
    """Unit vector along the axis."""
    order: int
    """Order of the symmetry: the rotations are by multiples of 360 degrees over the order."""
    exact: bool = False
    """Whether no measurement distinguishes the target before and after the rotation."""
    continuous: bool = False
    """Whether the same holds for every rotation about the axis: the angle about it is free."""


@dataclass(frozen=True, eq=False)
class Equivalence:
    """The attitudes equivalent to an attitude R: R times one of the turns, times any turn about the axis."""

    turns: FloatArray
    """Turns in target axes, the identity first, shape (K, 3, 3); one for each direction of a free axis."""
    free_axes: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    """Orthogonal unit vectors about which every turn is a symmetry, target axes, shape (F, 3): none, the axis
    of a body of revolution, or the three axes of a sphere."""

    @classmethod
    def of(cls, symmetries: Sequence[Symmetry]) -> Self:
        """Return the group that the exact symmetries generate."""
        exact = [each for each in symmetries if each.exact]
        free = [each for each in exact if each.continuous or each.order >= _ROUND]
        free_axes = np.array([each.axis for each in free[:1]]).reshape(-1, 3)
        if any(np.linalg.norm(np.cross(each.axis, free_axes[0])) > _SAME for each in free[1:]):
            return cls(np.eye(3)[None], np.eye(3))
        steps = [
            Rotation.from_rotvec(2.0 * pi / each.order * np.array(each.axis)).as_matrix()
            for each in exact
            if each not in free
        ]
        turns = [np.eye(3)]
        for turn in turns:  # the list grows
            for step in steps:
                apart = np.array(turns) - step @ turn
                if free:
                    apart = (apart @ free_axes[0])[..., None]
                if len(turns) < _MOST and np.abs(apart).max(axis=(1, 2)).min() > _SAME:
                    turns.append(step @ turn)
        return cls(np.array(turns), free_axes)

    @property
    def dof(self) -> int:
        """Number of a pose's degrees of freedom that measurements can determine."""
        return 6 - len(self.free_axes)

    @property
    def is_trivial(self) -> bool:
        """Whether an attitude is equivalent to itself alone."""
        return len(self.turns) == 1 and not len(self.free_axes)

    def cosines(self, attitudes: FloatArray, others: FloatArray) -> FloatArray:
        """Return the cosines of the least angles between attitudes, modulo the equivalence, shape (P, O).

        Args:
            attitudes: rotation matrices, shape (P, 3, 3).
            others: rotation matrices, shape (O, 3, 3).
        """
        if len(self.free_axes) == 3:
            return np.ones((len(attitudes), len(others)))
        turned, shape = attitudes[:, None] @ self.turns, (len(attitudes), len(self.turns), len(others))
        if not len(self.free_axes):
            cosines = 0.5 * ((turned.reshape(-1, 9) @ others.reshape(-1, 9).T) - 1.0)
        else:
            axis = self.free_axes[0]
            cosines = (turned @ axis).reshape(-1, 3) @ (others @ axis).T
        most: FloatArray = cosines.reshape(shape).max(axis=1, initial=-1.0)
        return most

    def nearest(self, attitudes: Rotation, found: Rotation) -> Rotation:
        """Return those of the attitudes equivalent to given ones that are nearest to found ones; one or N."""
        if len(self.free_axes) == 3:
            return found
        if len(self.turns) > 1:
            between = (found.inv() * attitudes).as_matrix()
            if not len(self.free_axes):
                alike = np.einsum("...ij,kji->...k", between, self.turns)  # 1 + 2 cos of the angle
            else:
                axis = self.free_axes[0]
                alike = (axis @ between) @ (self.turns @ axis).T
            attitudes = attitudes * Rotation.from_matrix(self.turns[alike.argmax(axis=-1)])
        return self._turned_onto(attitudes, found)

    def nearest_pose(self, pose: RigidTransform, found: RigidTransform) -> RigidTransform:
        """Return, among the poses equivalent to a given one, the one nearest to a found one."""
        rotation = self.nearest(pose.rotation, found.rotation)
        return RigidTransform.from_components(pose.translation, rotation)

    def error_of(self, found: RigidTransform, truth: RigidTransform) -> tuple[float, float]:
        """Return the attitude error, deg, and the position error, m, against the nearest equivalent pose.

        About a free axis no angle is an error.
        """
        attitude_rad, position_m = pose_error(self.nearest_pose(truth, found), found)
        return float(np.rad2deg(np.linalg.norm(attitude_rad))), float(np.linalg.norm(position_m))

    def _turned_onto(self, attitudes: Rotation, found: Rotation) -> Rotation:
        """Return attitudes, turned about the free axis alone to be nearest to found ones; one or N each."""
        if not len(self.free_axes):
            return attitudes
        (axis,) = self.free_axes
        off = (found.inv() * attitudes).as_quat()
        twist_rad = 2.0 * np.arctan2(off[..., :3] @ axis, off[..., 3])
        return attitudes * Rotation.from_rotvec(-twist_rad[..., None] * axis)

    def with_free_variance(self, covariance: FloatArray, R: FloatArray, variance: float) -> FloatArray:
        """Return covariances of (dp, dtheta) with a variance about the free axes, uncorrelated with the rest.

        Args:
            covariance: covariances in fixed axes (ICD section 1), shape (..., 6, 6).
            R: rotation matrices of the target in these axes, shape (..., 3, 3).
            variance: variance of the angle about a free axis, rad2.
        """
        if not len(self.free_axes):
            return covariance
        return with_variance_about(covariance, self.free_axes @ np.swapaxes(R, -1, -2), variance, first=3)


NO_SYMMETRY = Equivalence(np.eye(3)[None])
"""The equivalence of a target without exact symmetries."""


def with_variance_about(
    covariance: FloatArray, axes: FloatArray, variance: float, *, first: int
) -> FloatArray:
    """Return covariances with a variance along some directions, uncorrelated with the rest.

    Args:
        covariance: shape (..., N, N).
        axes: orthogonal unit vectors, shape (..., F, 3).
        variance: variance along them.
        first: index of the first of the three components to which the vectors refer.
    """
    along = np.zeros((*axes.shape[:-1], covariance.shape[-1]))
    along[..., first : first + 3] = axes
    outer = np.swapaxes(along, -1, -2) @ along
    across = np.eye(covariance.shape[-1]) - outer
    changed: FloatArray = across @ covariance @ across + variance * outer
    return changed
