"""Covariance of a pose from the joint least-squares fit, and its parts by how long the errors last."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from rpod_pose.pmd.joint.alternatives import Aligned
from rpod_pose.pmd.joint.edge_lines import Groups, shared_errors
from rpod_pose.pmd.joint.fit import JointFit, JointProblem, Shares, cell_information
from rpod_pose.pose_evidence import ErrorParts
from rpod_pose.registration.field_alignment import Points
from rpod_pose.registration.model_error import ModelError, Parts
from rpod_pose.registration.normal_equations import UNKNOWNS, information_of
from rpod_schemas.arrays import FloatArray
from rpod_target import Target

MIXED_PX = 0.16
"""Motion of the image after which the part of the edges' errors that does not last has a correlation of 1/e.
Campaign: of the errors of frames a quarter of a pixel apart, 0.2 of this part is left (as ``LASTING``)."""
LASTING = 0.5
"""Share of the variance of the edges' errors that lasts while the same parts of the target are seen: errors
of its brightness as rendered. Campaign: correlation of the errors of frames 1 to 5 px of turn apart, 0.51,
and 0.41 to 0.62 of one body up to 80 px apart; 25 sequences of the mock-up and four bodies of the derived
half (seeds 85 to 90)."""
COMMON_PX = 0.014
"""Standard deviation of a shift towards the darker side that all edges of a frame share, px: of blur, stray
light and brightness that the rendering does not have. Campaign: RMS of the excess over the stated errors at
the true pose, of the mock-up and seven bodies of the derived half (seeds 85 to 90) in four worlds, 128
frames; 0.013 px in three worlds that only report, 0.012 px for twelve bodies of an independent emulator."""
LEAST_CURVATURE = 0.1
"""Least second derivative of the loss along a motion, over its weight. Numerics: below it, the quadratic
expansion at the pose does not tell how far errors move the minimum."""


class BiasErrors(NamedTuple):
    """How well the bias of a frame's ranges is known."""

    prior_m: float
    """Standard deviation of the bias before the frame."""
    fitted_m: float
    """Standard deviation of the fitted bias if calibration and model are as good as assumed."""
    follows: float
    """Share of a bias of the ranges that the fitted one shows; the pose follows it by what is left."""


class Uncertainty(NamedTuple):
    """Covariance of a pose and its parts."""

    covariance: FloatArray
    """Covariance of (dp, dtheta), sensor axes, with all errors that the tracker assumes, shape (6, 6)."""
    parts: ErrorParts
    """Parts of the covariance by how long the errors last."""
    bias: BiasErrors
    """How well the bias of the ranges is known."""


class JointModelError:
    """Adds the errors of the target's model, which its file declares, to a covariance.

    Args:
        target: the target.
        edge_parts: index of the part of each sample of its edges, shape (N,).
    """

    def __init__(self, target: Target, edge_parts: NDArray[np.intp]) -> None:
        self._error, self._parts, self._edge_parts = ModelError.of(target), Parts.of(target), edge_parts

    @property
    def scale(self) -> float:
        """Relative standard deviation of the target's size."""
        return self._error.scale

    def added(self, fit: JointFit, problem: JointProblem, shares: Shares, alone: FloatArray) -> FloatArray:
        """Return the covariance of (dtau, dtheta, bias), shape (7, 7), with the errors of the model.

        Args:
            fit: the aligned pose.
            problem: points and edges at this pose.
            shares: weights of points and edges.
            alone: covariance without the errors of the model, shape (7, 7).
        """
        if not self._error.matters:
            return alone
        pose, sight, measured = fit.state.pose, problem.sight, problem.points
        points_m, samples = (measured.places_m - pose.t) @ pose.R, sight.expected.sample
        places_m = np.concatenate((points_m, sight.edges.places_m[samples]))
        of_place = np.concatenate((self._parts.at(points_m), self._edge_parts[samples]))
        cells = self._parts.cells(places_m, of_place)
        parts, centres_m = [], []
        for cell in range(int(cells.max(initial=-1)) + 1):
            of_points, of_edges = np.split(cells == cell, [len(points_m)])
            points = Points(np.ascontiguousarray(measured.places_m[of_points]), measured.trust[of_points])
            expected = sight.expected.only(of_edges)
            planes = problem.planes.only(of_points)
            own = problem._replace(points=points, planes=planes, sight=sight._replace(expected=expected))
            parts.append(cell_information(own, fit.state, shares))
            centres_m.append(places_m[cells == cell].mean(axis=0))
        if not parts:
            return alone
        return self._error.considered(alone, np.array(parts), np.array(centres_m))


def inverse_curvature(information: FloatArray, bend: FloatArray) -> FloatArray:
    """Return the inverse of the second derivatives of the loss, shape (7, 7).

    A robust loss is less curved than its weights say, because a larger residual has a smaller weight. So
    errors move its minimum farther than they move that of a sum of weighted squares (P. Huber, Robust
    Statistics, Wiley 1981, section 6.3: with the second derivatives A and the covariance J of the gradient,
    the covariance of the minimum is A^-1 J A^-1).

    Args:
        information: information matrix by the weights, shape (7, 7).
        bend: what it has more than the second derivatives, shape (7, 7).
    """
    shares, root = eigh(information - bend, information)
    scaled: FloatArray = root / np.maximum(shares, LEAST_CURVATURE)
    return scaled @ root.T


def uncertainty(
    aligned: Aligned,
    alone: FloatArray,
    whole: FloatArray,
    *,
    assumed: FloatArray,
    groups: Groups,
    weak: FloatArray,
    bias_m: float,
    radius_px: float,
    wider: float,
    of_body: float = 1.0,
) -> Uncertainty:
    """Return the uncertainty of an aligned pose.

    A has the second derivatives of the loss. Errors of residuals with the gradient covariance J cause the
    pose covariance A^-1 J A^-1. The bias of the ranges causes an error too, because its prior pulls it to
    zero; its J is the information of the prior. Edges share errors along a line and within a tile of the
    image (``edge_lines``). Edges beside saturated pixels are shifted towards their darker sides by a length
    that they share, and all edges by a smaller one. Both last as errors of the sensor do. The model's errors
    are those that the target's file declares. The distance to another likely alignment is an error of the
    image.

    Args:
        aligned: the aligned pose.
        alone: A^-1, shape (7, 7).
        whole: A^-1 with the errors of the target's model, shape (7, 7).
        assumed: inverse of the information matrix by the weights, shape (7, 7), of which the covariance
            with all assumed errors consists.
        groups: normal equations of groups of edges.
        weak: information that stands for any pose of a target in view, which is in ``alone``, shape (7, 7).
            Where a frame determines nothing, its error is that of this assumption, and none of the residuals.
        bias_m: standard deviation of the prior of the bias.
        radius_px: radius of the target in the image, px.
        wider: factor on all covariances, above 1 if the target is larger than the image. An image whose width
            is 1/n of the target shows only 1/n of its lines, so that errors that the residuals of a line
            share average out less.
        of_body: factor on the covariance of the edges' errors, which the target's file gives.
    """
    fit, beside = aligned.fit, aligned.spread
    white, uneven, of_image = (information_of(part, UNKNOWNS) for part in fit.evidence.parts)
    of_sensor = uneven.copy()
    of_sensor[-1, -1] += bias_m**-2
    white = white + weak
    of_some = alone[:, :6] @ fit.evidence.beside
    of_all = COMMON_PX * (alone[:, :6] @ fit.evidence.every)
    shifts = np.outer(of_some, of_some) + np.outer(of_all, of_all)
    of_groups = of_body * shared_errors(groups, alone, samples=alone @ of_image @ alone)
    follows = 1.0 - float(alone[-1, -1]) * bias_m**-2
    others = alone @ (white + uneven) @ alone + of_groups + shifts + whole - alone
    to_sensor = np.kron(np.eye(2), fit.state.pose.R)

    def turned(covariance: FloatArray, besides: FloatArray | float = 0.0) -> FloatArray:
        found: FloatArray = to_sensor @ (covariance[:6, :6] * wider + besides) @ to_sensor.T
        return found

    return Uncertainty(
        turned(assumed + whole - alone, beside),
        ErrorParts(
            white=turned(alone @ white @ alone),
            of_sensor=turned(alone @ of_sensor @ alone + shifts),
            of_image=turned((1.0 - LASTING) * of_groups, beside),
            image_turn_rad=MIXED_PX / radius_px,
            of_model=turned(whole - alone + LASTING * of_groups),
        ),
        bias=BiasErrors(bias_m, math.hypot(follows * bias_m, math.sqrt(others[-1, -1])), follows),
    )
