"""Estimation, from one frame, of errors that are the same along the whole line of an edge.

Shading, blur and the rendering's brightness shift an edge along its whole length. So its samples are not
independent, and no number of samples averages such an error out. The size of these errors follows from the
motion of the pose when one line is left out. This is the jackknife over groups (B. Efron, The Jackknife, the
Bootstrap and Other Resampling Plans, SIAM 1982, chapter 3), with a linear step for each group in place of a
new minimisation.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import kernel
from rpod_pose.pmd.joint.edge_points import add_edge_points
from rpod_pose.pmd.joint.expected_edges import EdgeSight, ExpectedEdges
from rpod_pose.pmd.joint.fit import JointProblem, Shares
from rpod_pose.registration.gauss_newton import State
from rpod_pose.registration.normal_equations import UNKNOWNS, gradient_of, information_of, no_sums
from rpod_schemas.arrays import FloatArray

MOST_LEVERAGE = 0.75
"""Largest share of the information about a motion that a line may have in the jackknife. Hand: if a line with
a larger share is left out, the frame does not determine the motion, and the linear step is too large."""
OF_POSE = 6
"""Number of unknowns of a pose. Physics: three of position, three of attitude."""


class Lines(NamedTuple):
    """Normal equations of the samples of each of L lines, for (dtau, dtheta, bias)."""

    gradients: FloatArray
    """Gradients, shape (L, 7)."""
    informations: FloatArray
    """Information matrices, shape (L, 7, 7)."""


@kernel
def line_sums(problem: JointProblem, state: State, shares: Shares, line: NDArray[np.intp]) -> Lines:
    """Return the normal equations of each line of edges, with the weights that all residuals have.

    Args:
        problem: the frame, with the expected samples.
        state: the aligned pose.
        shares: weights of points and edges.
        line: number of the line of each sample of the model, shape (N,).
    """
    expected, reach = problem.sight.expected, problem.schedule[-1, 1]
    of_sample = line[expected.sample]
    order = np.argsort(of_sample)
    ends = np.append(np.flatnonzero(np.diff(of_sample[order])) + 1, order.size)
    number = ends.size if order.size else 0
    gradients, informations = np.zeros((number, UNKNOWNS)), np.zeros((number, UNKNOWNS, UNKNOWNS))
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
        add_edge_points(sums, part, state.pose, reach, problem.edge_errors, False)
        gradients[k] = gradient_of(shares.edges * sums, UNKNOWNS)
        informations[k] = information_of(shares.edges * sums, UNKNOWNS)
    return Lines(gradients, informations)


def jackknife(lines: Lines, covariance: FloatArray, *, samples: FloatArray) -> FloatArray:
    """Return the covariance of (dtau, dtheta, bias) from errors that are the same along a line, shape (7, 7).

    Six of L lines only determine the pose and give no information about their errors. Therefore the result is
    a weighted mean, in which the covariance for independent samples has the weight 6 / L.

    Args:
        lines: normal equations of the lines.
        covariance: covariance by all residuals and priors, shape (7, 7).
        samples: covariance if the errors of all samples were independent, shape (7, 7).
    """
    seen = np.einsum("lii->l", lines.informations) > 0.0
    gradients, informations = lines.gradients[seen], lines.informations[seen]
    number = len(gradients)
    if number <= OF_POSE:
        return samples
    # in coordinates in which the whole information is the identity, eigenvalues of a line are its shares
    root = np.linalg.cholesky(covariance)
    whole, scaled = root.T @ informations @ root, gradients @ root
    large = np.einsum("lii->l", whole) > MOST_LEVERAGE  # if the sum of the shares is smaller, each share is
    steps = np.empty_like(scaled)
    steps[~large] = np.linalg.solve(np.eye(UNKNOWNS) - whole[~large], scaled[~large, :, None])[..., 0]
    shares, vectors = np.linalg.eigh(whole[large])
    along = np.einsum("lji,lj->li", vectors, scaled[large]) / (1.0 - np.minimum(shares, MOST_LEVERAGE))
    steps[large] = np.einsum("lij,lj->li", vectors, along)
    moved = steps @ root.T
    weight = (number - OF_POSE) / number
    found: FloatArray = weight * (number - 1) / number * moved.T @ moved + (1.0 - weight) * samples
    return found
