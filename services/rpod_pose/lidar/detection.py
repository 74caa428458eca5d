"""Whether a ray that meets the target comes back: learnt from the scan itself.

No estimator knows a LIDAR's power, its threshold, or how the target's surfaces have aged. What it knows is
that a brighter echo is detected rather than a dimmer one, and that a sensor for rendezvous is no weaker than
some: its data sheet names a range at which it works. The echo of a surface is

    e = albedo cos(theta) (R_least / R)^2,

with the albedo of its class (``brightness``) and that range R_least: 1 is a white surface seen squarely from
there. It is detected with the probability

    P(e) = surest / (1 + (half / e)^STEEPNESS).

Of this law one thing is unknown, ``half``: the echo of which half comes back, 1 at most. A pose says which
rays meet what, and the scan which of them came back, so that each pose learns its own; its likelihood is the
mean over all of them, with even weights from "everything is detected" to the weakest sensor. A pose that
needs a strange sensor to explain its scan has to explain all of its rays by the same one.

Without the bound, parts that lie far behind a near face could always be too dim to be seen, and a small body
be taken for the nearest face of a large one.
"""

from math import log
from typing import NamedTuple

import numpy as np

from rpod_schemas.arrays import FloatArray

HALVES: FloatArray = np.append(0.0, np.geomspace(1e-2, 1.0, 5))
"""Echoes of which half may come back, half a decade apart: those of sensors with one to ten times the least
range; 0 where everything does."""
STEEPNESS = log(81.0) / log(10.0)
"""From 10 to 90 % over a factor of ten: detectors take a factor of four, and the albedo of a class
is known within a factor of two."""
LEAST_LOG, RUNGS, RUNGS_PER_LOG = log(1e-4), 64, 4.5
"""Logarithm of the least echo of the table, its length, and its steps a unit of the logarithm."""
LINEAR_RUNGS, LINEAR_STEPS = 512, 64.0
"""Length of the table of ``expected_shares``, and its steps a unit of the echo."""


class Detection(NamedTuple):
    """Probabilities of each of ``HALVES`` at each echo, shape (H, RUNGS) each."""

    share: FloatArray
    """Of rays that come back."""
    log_share: FloatArray
    """Its logarithm."""
    log_missing: FloatArray
    """Logarithm of the share that does not."""


def detection(surest: float, clutter_share: float) -> Detection:
    """Return the tables of a sensor of which nothing else is known.

    Args:
        surest: most of the share that comes back.
        clutter_share: share of the rays whose return, or its lack, says nothing.
    """
    echoes = np.exp(LEAST_LOG + (np.arange(RUNGS) + 0.5) / RUNGS_PER_LOG)
    share = (1.0 - clutter_share) * _law(echoes, surest)
    return Detection(share, np.log(share + 1e-9), np.log(1.0 - share))


def expected_shares(surest: float) -> FloatArray:
    """Return the share of rays that come back over even steps of the echo, before the scan tells; (L,)."""
    echoes = np.arange(0.5, LINEAR_RUNGS, dtype=np.float64) / LINEAR_STEPS
    shares: FloatArray = _law(echoes, surest).mean(axis=0)
    return shares


def _law(echoes: FloatArray, surest: float) -> FloatArray:
    law: FloatArray = surest / (1.0 + (HALVES[:, None] / echoes) ** STEEPNESS)
    return law
