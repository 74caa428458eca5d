"""Test that distinguishes a pose refused by chance from an acceleration.

The gate refuses one pose in a hundred although nothing accelerates, and it refuses wrong poses. The refused
pose alone does not distinguish these from an acceleration, and a track that waited for more would lag behind
one. So an acceleration is assumed at once (``manoeuvre``), and a second filter continues beside the track. It
leaves the refused pose out, and expects no larger acceleration than configured. The next poses decide: behind
an acceleration the second filter lags more and more; otherwise they are as near to it as its smaller
covariance says.

This is the sequential probability ratio test (A. Wald, Sequential tests of statistical hypotheses, Annals of
Mathematical Statistics 16(2), 1945). Each filter states the density of a pose before it uses this pose.
Therefore the ratio of the products reaches r with at most the probability 1 / r if the other filter is right
(J. Ville, 1939). The limit is the reciprocal of the probability with which the gate refuses a right pose.

If the track is right, a new test begins: the acceleration may end at any time. Its second filter begins with
the state of the track.
"""

from dataclasses import replace
from math import log

import numpy as np
from scipy.special import chdtrc

from rpod_pose.navigation.dynamics.manoeuvre import followed
from rpod_pose.navigation.filter import CALM, FilterState, Innovation, Steady, Update, gate_nis, predict
from rpod_pose.navigation.pose_measurement import PoseMeasurement, updated
from rpod_schemas.config.estimator.filter import FilterConfig

LEAST = float(np.finfo(float).tiny)
"""Least probability of a refusal by chance. Numerics: its logarithm is finite."""


def decided(
    before: FilterState, after: FilterState, met: Update, measured: PoseMeasurement, config: FilterConfig
) -> FilterState:
    """Return the state after an accepted pose: of the track, or of the filter beside it if that is right.

    Args:
        before: the state after the previous measurement.
        after: the state of the track after the pose.
        met: the update with the pose as the track predicted it, before the pose raised any factor.
        measured: the pose.
        config: the filter's configuration.
    """
    if before.steady is None:
        if after.manoeuvre == CALM:
            return after
        by_chance = float(chdtrc(after.alike.dof, met.nis))
        return replace(after, steady=Steady(before, after.stamp_ns, by_chance))
    steady = before.steady
    predicted = predict(steady.state, measured.stamp_ns, config)
    found = updated(predicted, measured, config)
    log_odds = steady.log_odds + log_density(found.innovation) - log_density(met.innovation)
    beside = followed(steady.state, predicted, found, measured, config) if found.accepted else steady.state
    limit = -log(max(chdtrc(after.alike.dof, gate_nis(after, config)), LEAST))
    if found.accepted and log_odds > (0.0 if after.manoeuvre == CALM else limit):
        return beside
    if after.manoeuvre == CALM:
        return replace(after, steady=None)
    if log_odds < -limit:  # it has accelerated until now
        fresh = replace(after, manoeuvre=CALM, steady=None)
        return replace(after, steady=Steady(fresh, after.stamp_ns, 0.0))
    return replace(after, steady=replace(steady, state=beside, log_odds=log_odds))


def log_density(found: Innovation) -> float:
    """Return the logarithm of the normal density of an innovation, without the constant."""
    _, volume = np.linalg.slogdet(found.covariance)
    y = found.difference
    return -0.5 * float(y @ np.linalg.solve(found.covariance, y) + volume)
