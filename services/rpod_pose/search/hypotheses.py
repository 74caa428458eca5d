"""What a search lists beside its best pose: the poses that explain a measurement, with weights."""

from collections.abc import Sequence
from typing import Protocol

from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import pose_of
from rpod_schemas.types import Hypothesis

NEGLIGIBLE = 1e-3
"""Hypotheses with a smaller weight are not listed."""


class Placed(Protocol):
    """A pose of the target in the sensor."""

    @property
    def R(self) -> FloatArray:  # noqa: N802 - the rotation's name
        """Shape (3, 3)."""
        ...

    @property
    def t(self) -> FloatArray:
        """Shape (3,), m."""
        ...


def hypotheses(poses: Sequence[Placed], weights: FloatArray, turns: FloatArray) -> tuple[Hypothesis, ...]:
    """Return the poses with all turns that nobody sees, likeliest first; weights sum to 1.

    Args:
        poses: best first.
        weights: of the poses, shape (N,), summing to 1.
        turns: matrices of the target's exact symmetries, the identity included, shape (K, 3, 3).
    """
    listed = weights > NEGLIGIBLE
    shares = weights / weights[listed].sum() / len(turns)
    return tuple(
        Hypothesis(pose=pose_of(pose.R @ turn, pose.t), weight=float(share))
        for pose, share, kept in zip(poses, shares, listed, strict=True)
        if kept
        for turn in turns
    )
