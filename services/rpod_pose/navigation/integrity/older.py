"""The hypothesis that the newest frames are wrong, and the solutions without them.

The solution without these frames is a prediction over some tenths of a second. It depends on whether the
target accelerates. The older poses leave that open where the gate has refused one of them, and the poses that
decide are among the newest ones (``dynamics/steady``). Then there are two solutions, with and without an
acceleration. By Bayes's rule, the odds of an acceleration are its prior over the probability of such a
refusal by chance, times the likelihood ratio of the older poses. The prior is that of a wrong prediction
(``refused``).
"""

from collections.abc import Sequence
from dataclasses import replace
from math import exp

from rpod_pose.belief import SYMMETRY
from rpod_pose.navigation.dynamics.manoeuvre import greatest
from rpod_pose.navigation.filter import POSE, FilterState, Manoeuvre, Steady, predict, separation_of
from rpod_pose.navigation.history import History
from rpod_pose.navigation.integrity.frame_evidence import MOST_LOG_ODDS
from rpod_pose.navigation.integrity.levels import Solution, solution
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.config.estimator.integrity import IntegrityTuning
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.types import Hypothesis


def older_solutions(
    history: History, estimate: FilterState, config: FilterConfig, tuning: IntegrityTuning
) -> list[Solution]:
    """Return the solutions without the newest frames; none if the filter began with them.

    Args:
        history: the measurements.
        estimate: the estimate, whose stamp the solutions get.
        config: configuration of the filter.
        tuning: time of the newest frames, and the priors.
    """
    older = history.without_newest(history.state.stamp_ns - round(tuning.group_s * NANOSECONDS))
    if older is None:
        return []
    name, share = "without the newest frames", tuning.group_share
    accelerating = 1.0 if older.steady is None else _accelerating(older.steady, tuning.fault_share)
    found = [solution(name, estimate, _predicted(older, estimate.stamp_ns, config), share * accelerating)]
    if older.steady is not None and accelerating < 1.0:
        there = predict(older.steady.state, estimate.stamp_ns, config)
        found.append(solution(name, estimate, there, share * (1.0 - accelerating)))
    return found


def _accelerating(steady: Steady, share: float) -> float:
    """Return the probability that the target accelerates, and that the pose was not refused by chance."""
    by_chance = steady.by_chance * exp(min(steady.log_odds, MOST_LOG_ODDS))
    return share / (share + by_chance)


def _predicted(older: FilterState, stamp_ns: int, config: FilterConfig) -> FilterState:
    """Return a prediction whose twist becomes at most as uncertain as a mission allows in this time.

    The factors of a state hold for the time until the next pose. A longer prediction with them would assume
    the largest acceleration anew in each such time.
    """
    step_s = (stamp_ns - older.stamp_ns) / NANOSECONDS
    if step_s <= 0.0:
        return older
    bound = greatest(step_s, older, config)

    def bounded(factors: Manoeuvre) -> Manoeuvre:
        return Manoeuvre(*(max(1.0, min(each)) for each in zip(factors, bound, strict=True)))

    return predict(
        replace(older, manoeuvre=bounded(older.manoeuvre), lag=bounded(older.lag)), stamp_ns, config
    )


def rival_solutions(hypotheses: Sequence[Hypothesis], estimate: FilterState, risk: float) -> list[Solution]:
    """Return the other hypotheses that explain the measurements and are more probable than the risk."""
    return [
        Solution(
            each.name,
            separation_of(estimate, replace(estimate, T_chaser_target=each.pose)),
            estimate.covariance[POSE, POSE],
            each.weight,
        )
        for each in hypotheses
        if each.name not in ("", SYMMETRY) and each.weight > risk
    ]
