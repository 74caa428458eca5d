"""Estimation, from one frame, of errors that edges share along a line and within a part of the image.

Shading, blur and the rendering's brightness shift an edge along its whole length, and the edges beside it. So
samples are not independent, and no number of samples averages such an error out. The size of these errors
follows from the motion of the pose when the samples of one line, or of one tile of the image, are left out.
This is the jackknife over groups (B. Efron, The Jackknife, the Bootstrap and Other Resampling Plans, SIAM
1982, chapter 3), with a linear step for each group in place of a new minimisation. Errors that are shared in
two ways have the sum of both covariances, less that of the samples that share both (A. C. Cameron, J. B.
Gelbach, D. L. Miller, Robust Inference with Multiway Clustering, Journal of Business and Economic Statistics
29(2), 2011).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from rpod_geometry.kernels import kernel
from rpod_pose.pmd.joint.brightness.local_brightness import TILE_PX
from rpod_pose.pmd.joint.edge_points import add_edge_points, seen_edge
from rpod_pose.pmd.joint.expected_edges import EdgeSight, ExpectedEdges
from rpod_pose.pmd.joint.fit import JointProblem, Shares
from rpod_pose.registration.gauss_newton import State
from rpod_pose.registration.lie_group import PoseArrays
from rpod_pose.registration.normal_equations import UNKNOWNS, gradient_of, information_of, no_sums
from rpod_schemas.arrays import FloatArray

MOST_LEVERAGE = 0.75
"""Largest share of the information about a motion that a line may have in the jackknife. Hand: if a line with
a larger share is left out, the frame does not determine the motion, and the linear step is too large."""
OF_POSE = 6
"""Number of unknowns of a pose. Physics: three of position, three of attitude."""


class Lines(NamedTuple):
    """Normal equations of the samples of each of L groups of edges, for (dtau, dtheta, bias)."""

    gradients: FloatArray
    """Gradients, shape (L, 7)."""
    informations: FloatArray
    """Information matrices, shape (L, 7, 7)."""
    bends: FloatArray
    """By how much the second derivatives of the loss are less than these, shape (L, 7, 7)."""

    def summed(self, group: NDArray[np.intp]) -> "Lines":
        """Return the sums over larger groups, by the number of each one's larger group, shape (L,)."""
        order = np.argsort(group, kind="stable")
        starts = np.flatnonzero(np.diff(group[order], prepend=-1))
        return Lines(*(np.add.reduceat(part[order], starts) for part in self)) if len(group) else self


class Groups(NamedTuple):
    """Edges in groups whose errors may be the same."""

    both: Lines
    """Samples of the same line and tile."""
    lines: Lines
    """Samples of the same line."""
    tiles: Lines
    """Samples of the same tile of the image."""


def grouped(problem: JointProblem, state: State, shares: Shares, line: NDArray[np.intp]) -> Groups:
    """Return the normal equations of groups of edges, with the weights that all residuals have.

    Args:
        problem: the frame, with the expected samples.
        state: the aligned pose.
        shares: weights of points and edges.
        line: number of the line of each sample of the model, shape (N,).
    """
    tile = tiles(problem.sight, state.pose)
    number = int(tile.max(initial=0)) + 1
    pairs, group = np.unique(line[problem.sight.expected.sample] * number + tile, return_inverse=True)
    both = group_sums(problem, state, shares, group)
    of_line, of_tile = np.divmod(pairs, number)
    return Groups(both, both.summed(of_line), both.summed(of_tile))


@kernel
def tiles(sight: EdgeSight, pose: PoseArrays) -> NDArray[np.intp]:
    """Return the number of the tile of the image in which each of M expected samples lies, shape (M,)."""
    patch, sample = sight.patch, sight.expected.sample
    across = patch.image.shape[1] // TILE_PX + 1
    found = np.empty(len(sample), np.intp)
    for m in range(len(sample)):
        at = seen_edge(sight.edges.places_m, sight.edges.directions, sample[m], pose, sight.lens).at
        row, column = (at.row - patch.row) // TILE_PX, (at.column - patch.column) // TILE_PX
        found[m] = int(max(row, 0.0)) * across + min(max(int(column), 0), across - 1)
    return found


@kernel
def group_sums(problem: JointProblem, state: State, shares: Shares, group: NDArray[np.intp]) -> Lines:
    """Return the normal equations of groups of edges, with the weights that all residuals have.

    Args:
        problem: the frame, with M expected samples.
        state: the aligned pose.
        shares: weights of points and edges.
        group: number of the group of each expected sample, shape (M,).
    """
    expected, reach = problem.sight.expected, problem.schedule[-1, 1]
    order = np.argsort(group)
    ends = np.append(np.flatnonzero(np.diff(group[order])) + 1, order.size)
    number = ends.size if order.size else 0
    gradients, informations = np.zeros((number, UNKNOWNS)), np.zeros((number, UNKNOWNS, UNKNOWNS))
    bends = np.zeros_like(informations)
    sight = problem.sight
    for k in range(number):
        mine = order[(ends[k - 1] if k else 0) : ends[k]]
        some = ExpectedEdges(
            expected.pose,
            expected.sample[mine],
            expected.place[mine],
            expected.probability[mine],
            expected.change[mine],
            expected.merged[mine],
            expected.before[mine],
        )
        sums = no_sums()
        part = EdgeSight(sight.edges, sight.lens, sight.patch, some, sight.every)
        found = add_edge_points(sums, part, state.pose, reach, problem.edge_errors)
        gradients[k] = gradient_of(shares.edges * sums, UNKNOWNS)
        informations[k] = information_of(shares.edges * sums, UNKNOWNS)
        bends[k] = information_of(shares.edges * found.sums.bend, UNKNOWNS)
    return Lines(gradients, informations, bends)


def shared_errors(groups: Groups, covariance: FloatArray, *, samples: FloatArray) -> FloatArray:
    """Return the covariance of (dtau, dtheta, bias) from errors of lines and of tiles, shape (7, 7).

    The difference of covariances may be negative along a motion. Then this part is 0.

    Args:
        groups: normal equations of the groups.
        covariance: inverse of the second derivatives of the whole loss, shape (7, 7).
        samples: covariance if the errors of all samples were independent, shape (7, 7).
    """
    both, lines, tiles = (jackknife(part, covariance, samples=samples) for part in groups)
    variances, root = eigh(lines + tiles - both, covariance)
    scaled: FloatArray = covariance @ root * np.sqrt(np.maximum(variances, 0.0))
    return scaled @ scaled.T


def jackknife(lines: Lines, covariance: FloatArray, *, samples: FloatArray) -> FloatArray:
    """Return the covariance of (dtau, dtheta, bias) from errors that a group shares, shape (7, 7).

    Six of L groups only determine the pose and give no information about their errors. Therefore the result
    is a weighted mean, in which the covariance for independent samples has the weight 6 / L.

    Args:
        lines: normal equations of the groups.
        covariance: inverse of the second derivatives of the whole loss, shape (7, 7).
        samples: covariance if the errors of all samples were independent, shape (7, 7).
    """
    seen = np.einsum("lii->l", lines.informations) > 0.0
    gradients, informations = lines.gradients[seen], (lines.informations - lines.bends)[seen]
    number = len(gradients)
    if number <= OF_POSE:
        return samples
    # in coordinates in which the whole information is the identity, eigenvalues of a line are its shares
    root = np.linalg.cholesky(covariance)
    whole, scaled = root.T @ informations @ root, gradients @ root
    most = np.einsum("lii->l", root.T @ lines.informations[seen] @ root)
    large = most > MOST_LEVERAGE  # if the sum of the shares is smaller, each share is
    steps = np.empty_like(scaled)
    steps[~large] = np.linalg.solve(np.eye(UNKNOWNS) - whole[~large], scaled[~large, :, None])[..., 0]
    shares, vectors = np.linalg.eigh(whole[large])
    along = np.einsum("lji,lj->li", vectors, scaled[large]) / (1.0 - np.minimum(shares, MOST_LEVERAGE))
    steps[large] = np.einsum("lij,lj->li", vectors, along)
    moved = steps @ root.T
    weight = (number - OF_POSE) / number
    found: FloatArray = weight * (number - 1) / number * moved.T @ moved + (1.0 - weight) * samples
    return found
