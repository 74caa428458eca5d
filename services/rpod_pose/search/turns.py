"""Rotations after which a target may be confused with itself."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, radians
from typing import Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rpod_pose.search.face_turns import face_turns
from rpod_pose.search.round_turns import RoundTurns, round_turns
from rpod_schemas.arrays import FloatArray
from rpod_target import Equivalence, Target

HALF_TURNS = Rotation.from_rotvec(np.pi * np.eye(3))
"""Half turns about the target's axes. Hand: the likeliest mistakes, if it declares no near-symmetries."""
LEAST_TURN_DEG = 1.0
"""Rotations by a smaller angle count as the identity. Hand: axes in target files are rounded."""

SAME_TURN_DEG = 10.0
"""Angle below which an alignment corrects the difference of two turns. Numerics: half the distance of the
attitudes of the search's first level."""


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
    """Rotations after which a target may be confused with itself."""

    all: FloatArray
    """All these rotations without the identity, the declared ones first, shape (T, 3, 3)."""
    declared: int
    """Number of the declared ones."""
    faces: FloatArray
    """Further rotations that map the main faces onto each other (``face_turns``), without the identity, shape
    (F, 3, 3)."""
    further: FloatArray
    """Those of ``faces`` that differ from ``all``, shape (N, 3, 3)."""
    about: RoundTurns
    """Turns about the axis of a nearly round target; none if it is not round, or has a free axis."""
    exact: Equivalence
    """Exact symmetries, which no measurement shows."""

    @property
    def compared(self) -> FloatArray:
        """The declared ones, then those of the faces, shape (N, 3, 3)."""
        return np.concatenate((self.all[: self.declared], self.faces))

    @classmethod
    def of(cls, target: Target) -> Self:
        """Return a target's near-symmetries (or half turns), a cube's turns, and half of each exact symmetry.

        The last ones are needed because a prism that is turned by half of its symmetry's angle looks almost
        the same.
        """
        exact = target.equivalence
        declared = _distinct([turn.rotation for turn in target.turns()], exact)
        declared = declared or _distinct(list(HALF_TURNS), exact)
        halves = [Rotation.from_rotvec(0.5 * Rotation.from_matrix(turn).as_rotvec()) for turn in exact.turns]
        every = _distinct([*declared, *Rotation.create_group("O"), *halves], exact)
        faces = _distinct([*declared, *face_turns(target)], exact)[len(declared) :]
        further = [turn for turn in faces if not _is_known(turn, every, exact)]
        about = RoundTurns.none() if len(exact.free_axes) else round_turns(target)
        return cls(_matrices(every), len(declared), _matrices(faces), _matrices(further), about, exact)

    def close(self, attitudes: FloatArray, others: FloatArray, angle_deg: float) -> NDArray[np.bool_]:
        """Return which attitudes are within an angle of which others, modulo the exact symmetries.

        Args:
            attitudes: R_sensor_target, shape (P, 3, 3).
            others: other R_sensor_target, shape (O, 3, 3).
            angle_deg: largest angle between two close attitudes.

        Returns:
            shape (P, O).
        """
        near: NDArray[np.bool_] = self.exact.cosines(attitudes, others) > cos(radians(angle_deg))
        return near

    def distinct(self, ranked: Sequence[PlacedT], angle_deg: float) -> list[PlacedT]:
        """Return ranked poses without those whose attitudes are close to a better one's.

        Args:
            ranked: poses of the target, best first.
            angle_deg: largest angle between two close attitudes.
        """
        attitudes = matrices(ranked)
        close = self.close(attitudes, attitudes, angle_deg)
        kept: list[int] = []
        for index in range(len(ranked)):
            if not close[index, kept].any():
                kept.append(index)
        return [ranked[index] for index in kept]


def _matrices(turns: Sequence[Rotation]) -> FloatArray:
    return np.array([turn.as_matrix() for turn in turns]).reshape(-1, 3, 3)


def matrices(poses: Sequence[Placed]) -> FloatArray:
    """Return the attitudes of poses, R_sensor_target, shape (P, 3, 3)."""
    return np.array([pose.R for pose in poses]).reshape(-1, 3, 3)


def _is_known(turn: Rotation, known: Sequence[Rotation], exact: Equivalence) -> bool:
    """Return whether an alignment from one of the known rotations would end at this one too."""
    if not known:
        return False
    cosines = exact.cosines(_matrices(known), turn.as_matrix()[None])
    return bool(cosines.max() > cos(radians(SAME_TURN_DEG)))


def _distinct(turns: Sequence[Rotation], exact: Equivalence) -> list[Rotation]:
    """Return the rotations that differ, modulo the exact symmetries, from the identity and each other."""
    kept = [Rotation.identity()]
    for turn in turns:
        known = np.array([other.as_matrix() for other in kept])
        if exact.cosines(known, turn.as_matrix()[None]).max() < cos(radians(LEAST_TURN_DEG)):
            kept.append(turn)
    return kept[1:]
