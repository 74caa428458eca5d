"""Probability that a ray that meets the target gives a return, estimated from the scan itself.

An estimator does not know the power of a LIDAR, its threshold, or how the target's surfaces have aged. It
knows that a brighter echo is detected more often than a dimmer one. It also knows the range R_least at which
even the weakest sensor detects every other pulse on a white surface; a data sheet states it. The echo of a
surface is

    e = albedo cos(theta) (R_least / R)^2,

with the albedo of its class (``brightness``). So a white surface at normal incidence at R_least has an echo
of 1. An echo is detected with the probability

    P(e) = surest / (1 + (half / e)^STEEPNESS).

One parameter of this law is unknown: ``half``, the echo that is detected with half of the largest
probability. A pose predicts which rays meet the target, and the scan shows which of them gave a return. So
each pose has its own estimate of ``half``. The likelihood of the pose is the mean over values of ``half``
with equal weights, from 0 (everything is detected) to 1 (the weakest sensor). All rays of one pose share one
value.

The upper bound of ``half`` is needed: without it, surfaces far behind a near face could always be too dim to
be detected, and a small body was accepted as the nearest face of a large one.
"""

from math import log
from typing import NamedTuple

import numpy as np

from rpod_schemas.arrays import FloatArray

HALVES: FloatArray = np.append(0.0, np.geomspace(1e-2, 1.0, 5))
"""Values of ``half``; 0 means that everything is detected. Numerics: half a decade apart, for sensors that
reach 1 to 10 times the least range."""
STEEPNESS = log(81.0) / log(10.0)
"""Exponent with which the probability rises from 10 to 90 % over a factor of ten. Physics: detectors need a
factor of four, and the albedo of a class is known within a factor of two."""
LEAST_LOG, RUNGS, RUNGS_PER_LOG = log(1e-4), 64, 4.5
"""Logarithm of the least echo of the table, number of its steps (rungs), and number of steps per unit of the
logarithm. Numerics: it covers echoes from 1e-4 to 120, each a quarter larger."""
LINEAR_RUNGS, LINEAR_STEPS = 512, 64.0
"""Length of the table of ``expected_shares``, and its steps per unit of the echo. Numerics: it covers echoes
up to 8 in equal steps."""


class Detection(NamedTuple):
    """Probabilities for each value in ``HALVES`` and each echo, each of shape (H, RUNGS)."""

    share: FloatArray
    """Probability that a ray gives a return."""
    log_share: FloatArray
    """Logarithm of that probability."""
    log_missing: FloatArray
    """Logarithm of the probability that a ray gives no return."""


def detection(surest: float, clutter_share: float) -> Detection:
    """Return the tables of detection for a sensor.

    Args:
        surest: largest probability of a return.
        clutter_share: share of rays whose result, return or none, is unrelated to the target.
    """
    echoes = np.exp(LEAST_LOG + (np.arange(RUNGS) + 0.5) / RUNGS_PER_LOG)
    share = (1.0 - clutter_share) * _detection_probability(echoes, surest)
    return Detection(share, np.log(share + 1e-9), np.log(1.0 - share))


def expected_shares(surest: float) -> FloatArray:
    """Return the prior probability of a return for equal steps of the echo, shape (LINEAR_RUNGS,)."""
    echoes = np.arange(0.5, LINEAR_RUNGS, dtype=np.float64) / LINEAR_STEPS
    shares: FloatArray = _detection_probability(echoes, surest).mean(axis=0)
    return shares


def _detection_probability(echoes: FloatArray, surest: float) -> FloatArray:
    law: FloatArray = surest / (1.0 + (HALVES[:, None] / echoes) ** STEEPNESS)
    return law
