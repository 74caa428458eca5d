"""Rotations by which a target may be mistaken for itself."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, radians
from typing import Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rpod_schemas.arrays import FloatArray
from rpod_target import Target

HALF_TURNS = Rotation.from_rotvec(np.pi * np.eye(3))
"""Half turns about the target's axes: the likeliest mistakes, if it declares no near-symmetries."""
LEAST_TURN_RAD = 1e-6
"""Rotations by a smaller angle count as the identity."""


class Placed(Protocol):
    """A pose of the target in the sensor."""

    @property
    def R(self) -> FloatArray:  # noqa: N802 - the rotation's name
        """R_sensor_target, shape (3, 3)."""
        ...

    @property
    def t(self) -> FloatArray:
        """Position of the target's origin, sensor axes, shape (3,), m."""
        ...


PlacedT = TypeVar("PlacedT", bound=Placed)


@dataclass(frozen=True, eq=False)
class Turns:
    """Rotations by which a target may be mistaken for itself."""

    all: FloatArray
    """All of them, without the identity, the declared ones first, shape (T, 3, 3)."""
    declared: int
    """Number of the declared ones."""
    exact: FloatArray
    """Exact symmetries, which no measurement shows, the identity first, shape (E, 3, 3)."""

    @classmethod
    def of(cls, target: Target) -> Self:
        """Return a target's declared near-symmetries (or half turns), and the rotations of a cube."""
        exact = Rotation.concatenate(
            [Rotation.identity(1), *(turn.rotation for turn in target.turns(exact=True))]
        )
        declared = _distinct([turn.rotation for turn in target.turns()], exact)
        declared = declared or _distinct(list(HALF_TURNS), exact)
        every = _distinct([*declared, *Rotation.create_group("O")], exact)
        matrices = np.array([turn.as_matrix() for turn in every]).reshape(-1, 3, 3)
        return cls(matrices, len(declared), exact.as_matrix())

    def close(self, attitudes: FloatArray, others: FloatArray, angle_deg: float) -> NDArray[np.bool_]:
        """Return which attitudes are within an angle of which others, modulo the exact symmetries.

        Args:
            attitudes: R_sensor_target, shape (P, 3, 3).
            others: other R_sensor_target, shape (O, 3, 3).
            angle_deg: greatest angle between two close attitudes.

        Returns:
            shape (P, O).
        """
        turned = (attitudes[:, None] @ self.exact).reshape(-1, 9)
        traces = (turned @ others.reshape(-1, 9).T).reshape(len(attitudes), len(self.exact), len(others))
        near: NDArray[np.bool_] = traces.max(axis=1, initial=-1.0) > 1.0 + 2.0 * cos(radians(angle_deg))
        return near

    def distinct(self, ranked: Sequence[PlacedT], angle_deg: float) -> list[PlacedT]:
        """Return ranked poses without those whose attitudes are close to a better one's.

        Args:
            ranked: poses of the target, best first.
            angle_deg: greatest angle between two close attitudes.
        """
        attitudes = matrices(ranked)
        close = self.close(attitudes, attitudes, angle_deg)
        kept: list[int] = []
        for index in range(len(ranked)):
            if not close[index, kept].any():
                kept.append(index)
        return [ranked[index] for index in kept]


def matrices(poses: Sequence[Placed]) -> FloatArray:
    """Return the attitudes of poses, R_sensor_target, shape (P, 3, 3)."""
    return np.array([pose.R for pose in poses]).reshape(-1, 3, 3)


def _distinct(turns: Sequence[Rotation], exact: Rotation) -> list[Rotation]:
    """Return the rotations that differ, modulo the exact symmetries, from the identity and each other."""
    kept: list[Rotation] = []
    for turn in turns:
        known = [exact, *(exact * other for other in kept)]
        if all(((turn.inv() * others).magnitude() > LEAST_TURN_RAD).all() for others in known):
            kept.append(turn)
    return kept
