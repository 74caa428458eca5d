"""Gauss-Newton steps on the likelihood of a whole frame: every pixel of the image, and the depth.

An alignment on edges uses only the steepest changes along their normals. Where edges are few, or so near one
another that they merge, its pose depends on the bias of the ranges, or is a false minimum. Every pixel of the
image tells more, at a larger cost: the target is rendered at twelve poses beside each one.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from rpod_geometry.rays import GridArrays
from rpod_pose.pmd.joint.alternatives import depth_errors_of, depth_loss
from rpod_pose.pmd.joint.brightness.brightness_fit import MOST_SIGMAS, UNEVEN, faintest
from rpod_pose.pmd.joint.brightness.patch_renderer import PatchRenderer
from rpod_pose.pmd.joint.depth_points import add_depth_points
from rpod_pose.pmd.joint.edge_search import Patch
from rpod_pose.pmd.joint.fit import JointProblem
from rpod_pose.registration.gauss_newton import State
from rpod_pose.registration.lie_group import PoseArrays, stepped
from rpod_pose.registration.normal_equations import UNKNOWNS, gradient_of, information_of, no_sums
from rpod_schemas.arrays import FloatArray

MOST_STEPS, MOST_TRIES = 5, 5
"""Largest number of steps, and of damped steps that are tried for each. Numerics: a budget of computation."""
LEAST_RISE = 0.5
"""Least rise of the log likelihood that a step must promise. Physics: one standard deviation of one
unknown."""
BESIDE_PX = 0.5
"""Distance in the image of the poses whose difference is a derivative. Numerics: they differ by more than the
distance of two rays, and by less than the width of an edge."""
FARTHEST_PX = 3.0
"""Largest component of a step in the image. Numerics: a step is then within the reach of the derivatives."""
DAMPING, DAMPED = 1e-3, 10.0
"""First damping of a step (K. Levenberg, D. Marquardt), and its factor after each step. Numerics: usual."""


class Whole(NamedTuple):
    """A frame, in which poses are compared."""

    patch: Patch
    rays: GridArrays
    """Rays of the patch's pixels, shape (per_px * rows, per_px * columns)."""
    per_px: int
    blur_px: float
    """Standard deviation of the blur of the image."""
    renderer: PatchRenderer
    depth_at: Callable[[PoseArrays], JointProblem]
    """Function that returns the points with the planes of the faces that they show at a pose."""
    px_m: float
    """Motion across the line of sight that moves the target by a pixel, m."""
    radius_m: float
    """Radius of the target."""

    def loss(self, state: State) -> float:
        """Return minus the log likelihood of a pose and a bias of the ranges."""
        problem = self.depth_at(state.pose)
        prior = 0.5 * (state.bias_m / problem.depth_errors.bias_m) ** 2
        image = self.renderer.misfit(self.rays, self.per_px, state.pose, self.patch)
        return image + depth_loss(problem, state) + prior

    def predicted(self, pose: PoseArrays) -> FloatArray:
        """Return the image at a pose, shape (N,)."""
        image = self.renderer.predicted(self.rays, self.per_px, pose, self.patch)
        return image.ravel().astype(np.float64)


class _Equations(NamedTuple):
    """Normal equations in units of ``BESIDE_PX``."""

    information: FloatArray
    """Shape (7, 7)."""
    gradient: FloatArray
    """Gradient of the log likelihood, shape (7,)."""
    steps: FloatArray
    """Column k is the step (dtau, dtheta, bias) of one unit of unknown k, shape (7, 7)."""

    def solved(self, damping: float) -> FloatArray:
        """Return the step in these units, shape (7,)."""
        diagonal = np.diag(np.diag(self.information) * damping + np.finfo(float).eps)
        step = np.linalg.solve(self.information + diagonal, self.gradient)
        return np.clip(step, -FARTHEST_PX / BESIDE_PX, FARTHEST_PX / BESIDE_PX)


def climbed(whole: Whole, start: State) -> tuple[State, float]:
    """Return the likeliest state near a given one, and the rise of the log likelihood to it."""
    state, damping = start, DAMPING
    first = least = whole.loss(start)
    for _ in range(MOST_STEPS):
        equations = _equations(whole, state)
        if 0.5 * equations.gradient @ equations.solved(0.0) < LEAST_RISE:
            break
        for _ in range(MOST_TRIES):
            step = equations.steps @ equations.solved(damping)
            following = State(stepped(state.pose, step[:6]), state.bias_m + step[6])
            loss = whole.loss(following)
            if loss < least:
                break
            damping *= DAMPED
        else:
            break
        state, least, damping = following, loss, damping / DAMPED
    return state, first - least


def _equations(whole: Whole, state: State) -> _Equations:
    """Return the normal equations of image, depth and the bias's prior at a state."""
    steps, pose = _steps(whole, state.pose), state.pose
    shown = whole.predicted(pose)
    beside = [
        whole.predicted(stepped(pose, step)) - whole.predicted(stepped(pose, -step))
        for step in np.ascontiguousarray(steps.T[:6, :6])  # kernels are compiled for contiguous arrays
    ]
    slopes, weight = 0.5 * np.column_stack(beside), _weights(whole, shown)
    residual = whole.patch.image.ravel() - shown
    of_depth, by_depth = _of_depth(whole.depth_at(pose), state)
    information, gradient = steps.T @ of_depth @ steps, -steps.T @ by_depth
    information[:6, :6] += slopes.T @ (weight[:, None] * slopes)
    gradient[:6] += slopes.T @ (weight * residual)
    return _Equations(information, gradient, steps)


def _weights(whole: Whole, shown: FloatArray) -> FloatArray:
    """Return the weight of each pixel, 0 for outliers and beside saturated ones, shape (N,)."""
    patch = whole.patch
    variance = UNEVEN**2 * shown**2 + faintest(patch) ** 2 + patch.noise**2
    counts = np.square(patch.image.ravel() - shown) < MOST_SIGMAS**2 * variance
    if patch.saturated.size:
        counts &= patch.saturated.ravel() == 0
    weight: FloatArray = counts / (4.0 * np.pi * whole.blur_px**2 * variance)
    return weight


def _steps(whole: Whole, pose: PoseArrays) -> FloatArray:
    """Return steps that move the image of the target by ``BESIDE_PX``, as ``_Equations.steps``.

    Two shift it across the line of sight, one along it, three turn it, and one is the bias of the ranges.
    """
    away_m = float(np.linalg.norm(pose.t))
    axes = np.linalg.svd((pose.R.T @ pose.t / away_m)[None])[2].T  # the line of sight, and two across it
    along_m = whole.px_m * away_m / whole.radius_m
    steps = np.zeros((UNKNOWNS, UNKNOWNS))
    steps[:3, :3] = axes * (along_m, whole.px_m, whole.px_m)
    steps[3:6, 3:6] = np.eye(3) * whole.px_m / whole.radius_m
    steps[6, 6] = along_m
    return BESIDE_PX * steps


def _of_depth(problem: JointProblem, state: State) -> tuple[FloatArray, FloatArray]:
    """Return information, (7, 7), and gradient of the loss, (7,), of the depth and the bias's prior."""
    points, sums = problem.points, no_sums()
    information, gradient = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS)
    if float(points.trust.sum()):
        variance, share = depth_errors_of(problem)
        reach_m = MOST_SIGMAS * float(np.sqrt(variance))
        add_depth_points(sums, points, problem.planes, state, problem.field, reach_m)
        information += information_of(share / variance * sums, UNKNOWNS)
        gradient += gradient_of(share / variance * sums, UNKNOWNS)
    information[6, 6] += problem.depth_errors.bias_m**-2
    gradient[6] += state.bias_m * problem.depth_errors.bias_m**-2
    return information, gradient
