"""The hypothesis that a measurement which the gate refused is right, and that the prediction is wrong.

A gate compares a measurement with a prediction. It cannot decide which of them is wrong. If both were right,
the normalised innovation squared (NIS) would be so large only by chance. By Bayes's rule, the smaller the
probability of this chance is, the more probable is a wrong prediction.
"""

from math import exp

import numpy as np
from scipy.special import chdtrc

from rpod_pose.navigation.dynamics.slewing import turns
from rpod_pose.navigation.filter import FilterState, predict
from rpod_pose.navigation.history import History
from rpod_pose.navigation.integrity.levels import Solution, solution
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.poses import rotation_matrix


def refused_solutions(history: History, share: float) -> list[Solution]:
    """Return the newest measurement as a solution if the gate refused it; otherwise none.

    Args:
        history: the measurements.
        share: prior probability that the prediction is wrong.
    """
    if not history.steps or history.steps[-1].outcome.accepted:
        return []
    step = history.steps[-1]
    found = step.outcome.innovation
    if not (np.isfinite(found.difference).all() and np.isfinite(found.noise).all()):
        return []
    by_chance = float(chdtrc(step.predicted.alike.dof, step.outcome.nis))
    probability = share / (share + by_chance)
    R = rotation_matrix(step.measurement.T_chaser_target)
    covariance = step.predicted.alike.with_free_variance(found.noise + found.lasting, R, 0.0)
    return [Solution("if the refused measurement is right", found.difference, covariance, probability)]


def turning_solutions(estimate: FilterState, config: FilterConfig, share: float) -> list[Solution]:
    """Return the estimate by the filter that follows a turning chaser, while a held attitude is assumed.

    Args:
        estimate: the track's estimate.
        config: the filter's configuration.
        share: prior probability that the chaser turns.
    """
    other = estimate.other
    if other is None or turns(estimate) or other.state.stamp_ns > estimate.stamp_ns:
        return []
    odds = share * exp(other.log_odds)
    there = predict(other.state, estimate.stamp_ns, config)
    return [solution("if the chaser turns", estimate, there, odds / (1.0 + odds))]
