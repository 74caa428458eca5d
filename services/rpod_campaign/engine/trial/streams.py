"""Random numbers of a trial."""

import numpy as np
from numpy.random import Generator


def stream(seed: int, trial: int, purpose: int = 0) -> Generator:
    """Return the random numbers of a trial, the same in every cell, so that cells compare in pairs."""
    return np.random.default_rng((seed, trial, purpose))
