"""Blocks of further states after pose and twist: errors that last from frame to frame, or unknown constants.

A block is a vector of states with a first-order Gauss-Markov process of its own. In a time t, and while the
target turns by an angle a relative to the line of sight, the values of its states are multiplied by
exp(-t / T - a / A), and noise keeps their standard deviation. A constant has infinite T and A.

A considered block is not estimated: its gain is zero, but its covariances with all other states are
propagated (S. F. Schmidt, Application of State-Space Methods to Navigation Problems, Advances in Control
Systems 3, 1966). So an error that many frames share does not average out in the covariance.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import exp, inf
from typing import NamedTuple

import numpy as np

from rpod_schemas.arrays import FloatArray

ALIKE_RAD = 0.1
"""Rotation of the target relative to the line of sight after which covariances of the earlier view have 1/e
of their weight. Physics: after it, the cosines by which faces are weighted have changed by a tenth."""

UNSEEN = "unseen acceleration"
"""Name of the block with the acceleration that may act where no frame measures (``dynamics/unseen``)."""


@dataclass(frozen=True, eq=False)
class Block:
    """Named states of one kind."""

    name: str
    value: FloatArray
    """Estimate, in units of the block, shape (size,)."""
    sigma: FloatArray
    """Standard deviation of each state before any measurement, and in the long run, shape (size,)."""
    time_constant_s: float = inf
    """Time after which the autocorrelation of a state is 1/e; 0 for a state that is independent each time."""
    turn_rad: float = inf
    """Rotation of the target relative to the line of sight after which the autocorrelation is 1/e."""
    considered: bool = False
    """Whether the block is only considered: no measurement changes its value."""
    spread: FloatArray | None = None
    """Covariance of the error that a considered block stands for, averaged over the measurements of this
    view, in the axes to which the error is fixed, shape (6, 6); of ``UNSEEN``, that of the acceleration at
    the newest measurement, chaser axes; None for any other block."""
    weight: float = 0.0
    """Number of averaged measurements; those of an earlier view count less."""

    @property
    def size(self) -> int:
        """Number of states."""
        return len(self.value)

    def kept(self, step_s: float, turn_rad: float) -> float:
        """Return the share of a state's value that is left after a step."""
        forgotten = _periods(step_s, self.time_constant_s) + _periods(turn_rad, self.turn_rad)
        return exp(-forgotten)


class Known(NamedTuple):
    """Blocks as another filter knows them."""

    blocks: tuple[Block, ...]
    covariance: FloatArray
    """Covariance of the errors of their states together, shape (n, n)."""


def _periods(length: float, constant: float) -> float:
    if constant > 0.0:
        return length / constant
    return inf if length > 0.0 else 0.0


def placed(blocks: Sequence[Block], first: int) -> Iterator[tuple[Block, slice]]:
    """Yield each block with the slice of its states in the covariance; the first begins at ``first``."""
    for block in blocks:
        yield block, slice(first, first + block.size)
        first += block.size


def variances(blocks: Sequence[Block]) -> FloatArray:
    """Return the variances of all states before any measurement, shape (n,)."""
    return np.concatenate([np.zeros(0), *(block.sigma**2 for block in blocks)])


def with_known(blocks: Sequence[Block], known: Known) -> Known:
    """Return blocks with the values and the covariance that another filter knows of them.

    Those that it does not know are as before any measurement. Those that only it knows are added.
    """
    given = {block.name: block for block in known.blocks}
    merged = tuple(
        replace(block, value=given.pop(block.name).value) if block.name in given else block
        for block in blocks
    )
    merged += tuple(given.values())
    covariance, places = np.diag(variances(merged)), {each.name: place for each, place in placed(merged, 0)}
    if known.blocks:
        there = np.r_[tuple(places[block.name] for block in known.blocks)]
        covariance[np.ix_(there, there)] = known.covariance
    return Known(merged, covariance)


def unknown(blocks: Sequence[Block]) -> tuple[Block, ...]:
    """Return the blocks with the values before any measurement, zero."""
    return tuple(replace(block, value=np.zeros(block.size)) for block in blocks)


def propagated_blocks(blocks: Sequence[Block], step_s: float, turn_rad: float) -> tuple[Block, ...]:
    """Return the blocks after a step without a measurement, in which the target turns by ``turn_rad``."""
    return tuple(_propagated(block, step_s, turn_rad) for block in blocks)


def _propagated(block: Block, step_s: float, turn_rad: float) -> Block:
    if block.spread is not None:
        return replace(block, weight=block.kept(step_s, turn_rad) * exp(-turn_rad / ALIKE_RAD) * block.weight)
    if block.value.any():
        return replace(block, value=block.kept(step_s, turn_rad) * block.value)
    return block


def averaged(block: Block, known: Block | None) -> Block:
    """Return a considered block with the average covariance of a measurement and of the earlier ones.

    The frames of one view share one error, but each states its covariance with noise. If the block followed
    each of them, the filter would take the differences for knowledge about the error.

    Args:
        block: the block with the covariance that the measurement states.
        known: the same block after the earlier measurements; None if there is none.
    """
    if block.spread is None or known is None or known.spread is None:
        return replace(block, weight=1.0)
    weight = known.weight + 1.0
    return replace(block, spread=known.spread + (block.spread - known.spread) / weight, weight=weight)


def step_of(blocks: Sequence[Block], step_s: float, turn_rad: float) -> tuple[FloatArray, FloatArray]:
    """Return the share of each state that is left after a step, and the variance of its noise, (n,) each."""
    kept = np.repeat([block.kept(step_s, turn_rad) for block in blocks], [block.size for block in blocks])
    return kept, (1.0 - kept**2) * variances(blocks)


def root_of(covariance: FloatArray) -> FloatArray:
    """Return the symmetric root of a covariance, shape (6, 6); eigenvalues below 0 count as 0."""
    values, vectors = np.linalg.eigh(covariance)
    root: FloatArray = (vectors * np.sqrt(values.clip(0.0))) @ vectors.T
    return root
