"""Which attitudes of a target no measurement tells apart, and errors modulo these.

An exact symmetry makes turned attitudes equivalent. Where every turn about an axis is a symmetry, the angle
about this axis is free: it is a convention, nothing is known of it, and no angle about it is an error.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi, sqrt
from typing import Self

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_schemas.arrays import FloatArray

FREE_SIGMA_RAD = pi / sqrt(3.0)
"""Standard deviation of an angle that is uniform over a turn: 104 deg."""
_SAME = 0.02
"""Greatest difference between components of two turns, or directions, that are one; files round axes."""
_MOST = 60
"""Greatest number of turns: the largest finite group without an axis of a high order, an icosahedron's."""
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
    free_axis: FloatArray | None = None
    """Unit vector of the axis about which every turn is a symmetry, target axes, shape (3,)."""

    @classmethod
    def of(cls, symmetries: Sequence[Symmetry]) -> Self:
        """Return the group that the exact symmetries generate."""
        exact = [each for each in symmetries if each.exact]
        free = [each for each in exact if each.continuous or each.order >= _ROUND]
        free_axis = np.array(free[0].axis) if free else None
        steps = [
            Rotation.from_rotvec(2.0 * pi / each.order * np.array(each.axis)).as_matrix()
            for each in exact
            if each not in free
        ]
        turns = [np.eye(3)]
        for turn in turns:  # the list grows
            for step in steps:
                apart = np.array(turns) - step @ turn
                if free_axis is not None:
                    apart = (apart @ free_axis)[..., None]
                if len(turns) < _MOST and np.abs(apart).max(axis=(1, 2)).min() > _SAME:
                    turns.append(step @ turn)
        return cls(np.array(turns), free_axis)

    @property
    def dof(self) -> int:
        """Number of a pose's degrees of freedom that measurements can tell."""
        return 6 if self.free_axis is None else 5

    def cosines(self, attitudes: FloatArray, others: FloatArray) -> FloatArray:
        """Return the cosines of the least angles between attitudes, modulo the equivalence, shape (P, O).

        Args:
            attitudes: rotation matrices, shape (P, 3, 3).
            others: rotation matrices, shape (O, 3, 3).
        """
        turned, shape = attitudes[:, None] @ self.turns, (len(attitudes), len(self.turns), len(others))
        if self.free_axis is None:
            cosines = 0.5 * ((turned.reshape(-1, 9) @ others.reshape(-1, 9).T) - 1.0)
        else:
            cosines = (turned @ self.free_axis).reshape(-1, 3) @ (others @ self.free_axis).T
        most: FloatArray = cosines.reshape(shape).max(axis=1, initial=-1.0)
        return most

    def nearest(self, attitudes: Rotation, found: Rotation) -> Rotation:
        """Return, of the attitudes equivalent to given ones, those nearest to found ones; one or N each."""
        if len(self.turns) > 1:
            between = (found.inv() * attitudes).as_matrix()
            if self.free_axis is None:
                alike = np.einsum("...ij,kji->...k", between, self.turns)  # 1 + 2 cos of the angle
            else:
                alike = (self.free_axis @ between) @ (self.turns @ self.free_axis).T
            attitudes = attitudes * Rotation.from_matrix(self.turns[alike.argmax(axis=-1)])
        return self._turned_onto(attitudes, found)

    def nearest_pose(self, pose: RigidTransform, found: RigidTransform) -> RigidTransform:
        """Return, of the poses equivalent to a given one, that nearest to a found one."""
        rotation = self.nearest(pose.rotation, found.rotation)
        return RigidTransform.from_components(pose.translation, rotation)

    def _turned_onto(self, attitudes: Rotation, found: Rotation) -> Rotation:
        """Return attitudes, turned about the free axis alone to be nearest to found ones; one or N each."""
        if self.free_axis is None:
            return attitudes
        off = (found.inv() * attitudes).as_quat()
        twist_rad = 2.0 * np.arctan2(off[..., :3] @ self.free_axis, off[..., 3])
        return attitudes * Rotation.from_rotvec(-twist_rad[..., None] * self.free_axis)

    def with_free_variance(self, covariance: FloatArray, R: FloatArray, variance: float) -> FloatArray:
        """Return covariances of (dp, dtheta) with a variance about the free axis, uncorrelated with the rest.

        Args:
            covariance: covariances in fixed axes (ICD section 1), shape (..., 6, 6).
            R: rotation matrices of the target in these axes, shape (..., 3, 3).
            variance: variance of the angle about the free axis, rad2.
        """
        if self.free_axis is None:
            return covariance
        return with_variance_about(covariance, R @ self.free_axis, variance, first=3)


NO_SYMMETRY = Equivalence(np.eye(3)[None])
"""The equivalence of a target without exact symmetries."""


def with_variance_about(
    covariance: FloatArray, axis: FloatArray, variance: float, *, first: int
) -> FloatArray:
    """Return covariances with a variance along one direction, uncorrelated with the rest.

    Args:
        covariance: shape (..., N, N).
        axis: unit vectors, shape (..., 3).
        variance: variance along them.
        first: index of the first of the three components to which the vectors refer.
    """
    along = np.zeros(covariance.shape[:-1])
    along[..., first : first + 3] = axis
    outer = along[..., :, None] * along[..., None, :]
    across = np.eye(covariance.shape[-1]) - outer
    changed: FloatArray = across @ covariance @ across + variance * outer
    return changed
