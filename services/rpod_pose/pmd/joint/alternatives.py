"""Several alignments of one frame, from which the likeliest one is chosen by the whole image.

If edges are so near one another that they merge, it depends on the materials which one the image shows, and
these are known only roughly. So a frame is aligned twice: with all edges, and without those that a rendering
merges with others. If the two poses differ, the likelier one is chosen, and its covariance contains the
distance of the other one.

An alignment from a prediction that is some pixels off may end at a wrong pose, where edges match their
neighbours. It is repeated from poses around its end, until one returns to the likeliest pose, or no further
start leads to a likelier one. Before that, it is repeated from poses along the line of sight: because of a
bias of the ranges, the outline may have been beyond the reach of the search for edges.
"""

from collections.abc import Callable, Sequence
from functools import cache
from math import hypot
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, expit, ndtri, softmax

from rpod_geometry.rays import NEAREST_M
from rpod_pose.pmd.joint.brightness.brightness_fit import MOST_SIGMAS
from rpod_pose.pmd.joint.depth_points import add_depth_points
from rpod_pose.pmd.joint.fit import JointFit, JointProblem
from rpod_pose.pmd.joint.frame import moved_px
from rpod_pose.ports import Registration
from rpod_pose.registration.gauss_newton import State
from rpod_pose.registration.lie_group import PoseArrays, step_between, stepped, turned
from rpod_pose.registration.normal_equations import no_sums
from rpod_pose.search.even_samples import sobol, steps_of
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import pose_of

CLEAR_LOG = 0.5 * float(chdtri(1, 0.05))
"""Least difference of two log likelihoods at which one pose is preferred. Physics: a likelihood-ratio test at
95 %."""
MOST_DROP_LOG = 0.5 * float(chdtri(6, 0.01))
"""Largest decrease of the log likelihood by an accepted alignment. Physics: the six parameters of the pose
may have been fitted to noise before, and a likelihood-ratio test at 99 % allows for them."""
LEADS_PX = 0.1
"""Least motion in the image at which further steps are said to lead away from a pose. Physics: a tenth of a
pixel is the least error of an edge."""
SAME_PX = 0.25
"""Largest distance in the image between two alignments that count as the same. Physics: two and a half times
the least error of an edge, a tenth of a pixel."""
PATIENCE, MOST_STARTS = 3, 12
"""Number of starts without a likelier pose after which no further one is tried, and largest number of starts.
Numerics: budgets of computation."""
RETURNED_PX = 0.1
"""Largest distance in the image of an end from the likeliest pose that counts as the same pose. Physics: a
tenth of a pixel is the least error of an edge."""
START_PX = 2.5
"""Distance in the image of a start from the likeliest pose so far. Numerics: a start is then within the reach
of the search for edges (3 px), and beyond the width of an edge."""
SHIFT_SHARE = 0.3
"""Standard deviation of a start's shift along each axis, over its motion by rotation. Numerics: the distance
of most starts is then nearly that of their rotation alone."""
EXPECTED_RISE = 3.0
"""Expected increase of minus a true log likelihood from its best pose to a pose drawn from its covariance.
Physics: half of the six degrees of freedom."""
DRAWN_POWER = 3
"""Logarithm to base 2 of the number of poses that are drawn from a covariance. Numerics: a budget; a mean of
eight is right within a third."""
MOST_BIAS_SIGMAS, MOST_MOVES = 2.0, 4
"""Largest bias that is searched, in sigmas, and largest number of poses on each side. Numerics: budgets."""
ALONE = np.zeros((6, 6))
"""Spread of an alignment without alternatives."""


class Aligned(NamedTuple):
    """A pose aligned with a frame."""

    fit: JointFit
    last: JointProblem
    """Problem of the last steps."""
    spread: FloatArray = ALONE
    """Covariance of (dtau, dtheta) caused by alternative alignments, weighted by their probability, target
    axes, shape (6, 6)."""

    def beside(self, other: "Aligned", more_loss: float) -> "Aligned":
        """Return this alignment with the distance of an alternative one in its spread.

        Args:
            other: the less likely alignment.
            more_loss: log likelihood of this alignment minus that of the other one, at least 0.
        """
        away = step_between(*(pose_of(*each.fit.state.pose) for each in (self, other)))
        return self._replace(spread=expit(-more_loss) * np.outer(away, away))


def along_sight(state: State, *, sigma_m: float, step_m: float) -> list[State]:
    """Return poses nearer and farther than one, each with the bias of the ranges with which the depth fits.

    A pose that was found by depth is displaced by the bias of the ranges. If the bias is a large part of the
    range, the outline in the image is farther off than the reach of the search for edges.

    Args:
        state: the pose, with its bias.
        sigma_m: standard deviation of the bias, m.
        step_m: distance of two poses, m. If it is larger than the bias may be, the result is empty.
    """
    (R, t), bias_m = state
    number = int(min(MOST_BIAS_SIGMAS * sigma_m / step_m, MOST_MOVES))
    range_m = max(hypot(*t), NEAREST_M)
    steps_m = [move * step_m for move in range(-number, number + 1) if move]
    nearest = NEAREST_M / range_m
    return [State(PoseArrays(R, t * max(1.0 - step / range_m, nearest)), bias_m + step) for step in steps_m]


def depth_loss(problem: JointProblem, state: State) -> float:
    """Return minus the log likelihood of the depth at a pose, up to a constant.

    The points have the weight of at most ``most_points`` independent points, as in the alignment.
    """
    points = problem.points
    whole = float(points.trust.sum())
    if not whole:
        return 0.0
    variance, share = depth_errors_of(problem)
    most = MOST_SIGMAS * float(np.sqrt(variance))
    near = add_depth_points(no_sums(), points, problem.planes, state, problem.field, most)
    squares = near.squares_m2 + (whole - near.trusted) * most**2
    return 0.5 * share * squares / variance


def depth_errors_of(problem: JointProblem) -> tuple[float, float]:
    """Return the variance of a point's residual, m2, and the share of the points that are independent."""
    errors, whole = problem.depth_errors, float(problem.points.trust.sum())
    variance = max(errors.noise_m**2, errors.spread_m2) + errors.uneven_m**2 + errors.slack_m**2
    return variance, min(errors.most_points, whole) / whole


def likeliest(
    first: Aligned,
    *,
    loss: Callable[[Aligned], float],
    aligned_from: Callable[[State], Aligned],
    px_m: float,
    radius_m: float,
    along_sight: Sequence[State] = (),
    rivals: Callable[[State], Sequence[State]] = lambda _: (),
) -> Aligned:
    """Return the likeliest of several alignments, with the distances of the others in its spread.

    The starts lie around the likeliest pose so far. One that ends there again ends the search.

    Args:
        first: the alignment from the prediction.
        loss: function that returns minus the log likelihood of an alignment.
        aligned_from: function that returns the alignment from another start.
        px_m: motion across the line of sight that moves the target by a pixel, m.
        radius_m: radius of the target.
        along_sight: starts nearer and farther than the end of ``first``, which are tried first.
        rivals: function that returns poses at which the target looks nearly the same as at the likeliest one.
            They are less likely by the prediction, so that they count for the spread alone.
    """
    tried = [first, *(aligned_from(start) for start in along_sight)]
    losses = [loss(each) for each in tried]
    place = 0 if losses[0] <= min(losses) + CLEAR_LOG else int(np.argmin(losses))
    best, least, since = tried[place], losses[place], 0
    for shift, turn in start_steps():
        if since == PATIENCE:
            break
        step = START_PX * px_m * np.concatenate((shift, turn / radius_m))
        (pose, bias_m), since = best.fit.state, since + 1
        tried.append(aligned_from(State(stepped(pose, step), bias_m)))
        losses.append(loss(tried[-1]))
        if losses[-1] < least - CLEAR_LOG:
            best, least, since = tried[-1], losses[-1], 0
        elif moved_px(pose, tried[-1].fit.state.pose, radius_m, 1.0 / px_m) < RETURNED_PX:
            break
    for start in rivals(best.fit.state):
        tried.append(aligned_from(start))
        losses.append(loss(tried[-1]))
    T_best, spread = pose_of(*best.fit.state.pose), best.spread.copy()
    for each, weight in zip(tried, softmax(-np.array(losses)), strict=True):
        away = step_between(T_best, pose_of(*each.fit.state.pose))
        spread += weight * np.outer(away, away)
    return best._replace(spread=spread)


def poses_of(found: Sequence[Registration]) -> list[PoseArrays]:
    """Return the poses of registrations, each of which has one."""
    return [PoseArrays.of(each.T_sensor_target) for each in found if each.T_sensor_target is not None]


def log_likelihoods(
    found: Sequence[Registration], loss: Callable[[State], float], *, ranked_only: bool = False
) -> FloatArray:
    """Return the log likelihoods of one frame at registered poses, shape (N,), up to a constant.

    The losses compare the image as if model, lens and rendering were right to a fraction of a pixel. They are
    not, and a pose is not better known than its covariance states. If the losses were true log likelihoods, a
    pose drawn from the covariance would differ from the likeliest one by half a unit for each of the six
    parameters. If the losses differ more, the excess is an error that no hypothesis explains. Both losses of
    a difference contain it. Therefore all losses are divided by twice the ratio of these differences.

    Args:
        found: the poses, each with its range bias and covariance.
        loss: function that returns minus the log likelihood of a pose; it may be too steep.
        ranked_only: whether only the order of the poses is needed. Then the losses are not divided.
    """
    biases_m = (each.range_bias_m for each in found)
    states = [State(*each) for each in zip(poses_of(found), biases_m, strict=True)]
    losses = np.array([loss(state) for state in states])
    if ranked_only:
        return -losses
    best = int(losses.argmin())
    (R, t), bias_m = states[best]
    ray, covariance = t / np.linalg.norm(t), found[best].covariance
    drawn = [
        State(PoseArrays(turned(R, R.T @ step[3:]), t + step[:3]), bias_m - float(ray @ step[:3]))
        for step in steps_of(covariance, DRAWN_POWER)
    ]
    rises = np.array([loss(state) for state in drawn]) - losses[best]
    found_logs: FloatArray = -losses / max(2.0 * float(np.sqrt((rises**2).mean())) / EXPECTED_RISE, 1.0)
    return found_logs


@cache
def start_steps() -> FloatArray:
    """Return shifts and unit turns of starts, target axes, shape (``MOST_STARTS``, 2, 3); deterministic."""
    even = ndtri(sobol(6, int(np.ceil(np.log2(MOST_STARTS)))))[:MOST_STARTS].reshape(-1, 2, 3)
    even[:, 0] *= SHIFT_SHARE
    even[:, 1] /= np.linalg.norm(even[:, 1], axis=1, keepdims=True)
    return even
