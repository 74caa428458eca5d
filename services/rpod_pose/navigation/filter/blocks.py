"""Blocks of further states behind pose and twist: errors that last from frame to frame, or unknown constants.

A block is a vector of states with a first-order Gauss-Markov process of its own: within a time t, and while
the target is turned by an angle a as the sensors see it, its states forget all but exp(-t / T - a / A) of
their values, and noise keeps their standard deviation. A constant has infinite T and A.

A considered block is not estimated: its gain is zero, but its covariances with all other states are carried
(S. F. Schmidt, Application of State-Space Methods to Navigation Problems, Advances in Control Systems 3,
1966). So an error that many frames share does not average out in the covariance.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import exp, inf

import numpy as np

from rpod_schemas.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Block:
    """Named states of one kind."""

    name: str
    value: FloatArray
    """Estimate, in units of the block, shape (size,)."""
    sigma: FloatArray
    """Standard deviation of each state before any measurement, and in the long run, shape (size,)."""
    time_constant_s: float = inf
    """Time after which the correlation of a state with itself is 1/e; 0 for a state that is new each time."""
    turn_rad: float = inf
    """The same for the angle by which the target has turned, as the sensors see it."""
    considered: bool = False
    """Whether the block is only considered: no measurement changes its value."""

    @property
    def size(self) -> int:
        """Number of states."""
        return len(self.value)

    def kept(self, step_s: float, turn_rad: float) -> float:
        """Return the share of a state's value that is left after a step."""
        forgotten = _periods(step_s, self.time_constant_s) + _periods(turn_rad, self.turn_rad)
        return exp(-forgotten)


def _periods(length: float, constant: float) -> float:
    if constant > 0.0:
        return length / constant
    return inf if length > 0.0 else 0.0


def placed(blocks: Sequence[Block], first: int) -> Iterator[tuple[Block, slice]]:
    """Yield each block with the place of its states in the covariance, from the index ``first`` on."""
    for block in blocks:
        yield block, slice(first, first + block.size)
        first += block.size


def variances(blocks: Sequence[Block]) -> FloatArray:
    """Return the variances of all states before any measurement, shape (n,)."""
    return np.concatenate([np.zeros(0), *(block.sigma**2 for block in blocks)])


def unknown(blocks: Sequence[Block]) -> tuple[Block, ...]:
    """Return the blocks as before any measurement."""
    return tuple(replace(block, value=np.zeros(block.size)) for block in blocks)


def faded(blocks: Sequence[Block], step_s: float, turn_rad: float) -> tuple[Block, ...]:
    """Return the blocks after a step without a measurement, in which the target turns by ``turn_rad``."""
    return tuple(
        replace(block, value=block.kept(step_s, turn_rad) * block.value) if block.value.any() else block
        for block in blocks
    )


def step_of(blocks: Sequence[Block], step_s: float, turn_rad: float) -> tuple[FloatArray, FloatArray]:
    """Return the share of each state that is left after a step, and the variance of its noise, (n,) each."""
    kept = np.repeat([block.kept(step_s, turn_rad) for block in blocks], [block.size for block in blocks])
    return kept, (1.0 - kept**2) * variances(blocks)
