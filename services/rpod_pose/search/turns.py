"""Rotations by which a target may be mistaken for itself, and the number of points that a search compares."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from rpod_schemas.arrays import FloatArray
from rpod_target import Target

HALF_TURNS = Rotation.from_rotvec(np.pi * np.eye(3))
"""Half turns about the target's axes: the likeliest mistakes, if it declares no near-symmetries."""
LEAST_TURN_RAD = 1e-6
"""Rotations by a smaller angle count as the identity."""
FEW_RETURNS, FEW_POINTS = 64, 80
"""Number of returns of the scan and of points of the model in the comparison of all attitudes."""
MORE_RETURNS = 256
"""Number of returns in the comparison of the better attitudes, with all points of the model."""


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


def _distinct(turns: Sequence[Rotation], exact: Rotation) -> list[Rotation]:
    """Return the rotations that differ, modulo the exact symmetries, from the identity and each other."""
    kept: list[Rotation] = []
    for turn in turns:
        known = [exact, *(exact * other for other in kept)]
        if all(((turn.inv() * others).magnitude() > LEAST_TURN_RAD).all() for others in known):
            kept.append(turn)
    return kept
