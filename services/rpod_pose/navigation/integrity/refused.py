"""The hypothesis that a measurement which the gate refused is right, and that the prediction is wrong.

A gate compares a measurement with a prediction. It cannot decide which of them is wrong. If both were right,
the normalised innovation squared (NIS) would be so large only by chance. By Bayes's rule, the smaller the
probability of this chance is, the more probable is a wrong prediction.
"""

import numpy as np
from scipy.special import chdtrc

from rpod_pose.navigation.history import History
from rpod_pose.navigation.integrity.levels import Solution
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
