"""Turns by which a target may be mistaken for itself, and how many points a search compares."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from rpod_schemas.arrays import FloatArray
from rpod_target import Target

HALF_TURNS = Rotation.from_rotvec(np.pi * np.eye(3))
"""About the target's axes: what it is most easily mistaken by, where it declares no near-symmetries."""
LEAST_TURN_RAD = 1e-6
"""Smaller turns are none."""
FEW_RETURNS, FEW_POINTS = 64, 80
"""Of the scan and of the model, that all attitudes are compared on."""
MORE_RETURNS = 256
"""Of the scan, that the better ones are compared on, with all points of the model."""


@dataclass(frozen=True, eq=False)
class Turns:
    """What a target may be mistaken for itself by."""

    all: FloatArray
    """Without the identity, the declared ones first, shape (T, 3, 3)."""
    declared: int
    exact: FloatArray
    """Those that nobody sees, the identity first, shape (E, 3, 3)."""

    @classmethod
    def of(cls, target: Target) -> Self:
        """Return the declared near-symmetries, else half turns, and quarter turns about the axes."""
        exact = Rotation.concatenate(
            [Rotation.identity(1), *(turn.rotation for turn in target.turns(exact=True))]
        )
        declared = _told_apart([turn.rotation for turn in target.turns()], exact)
        declared = declared or _told_apart(list(HALF_TURNS), exact)
        every = _told_apart([*declared, *Rotation.create_group("O")], exact)
        matrices = np.array([turn.as_matrix() for turn in every]).reshape(-1, 3, 3)
        return cls(matrices, len(declared), exact.as_matrix())


def _told_apart(turns: Sequence[Rotation], exact: Rotation) -> list[Rotation]:
    """Return the turns that differ from the exact ones, and from each other by more than those."""
    kept: list[Rotation] = []
    for turn in turns:
        known = [exact, *(exact * other for other in kept)]
        if all(((turn.inv() * others).magnitude() > LEAST_TURN_RAD).all() for others in known):
            kept.append(turn)
    return kept
