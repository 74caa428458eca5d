"""Errors of a pose by the joint least squares, by how long they last."""

from typing import NamedTuple

import numpy as np

from rpod_pose.pmd.joint.edge_lines import Lines, jackknife
from rpod_pose.pmd.joint.fit import JointFit
from rpod_pose.ports import ErrorParts
from rpod_pose.registration.normal_equations import UNKNOWNS, gradient_of, information_of
from rpod_schemas.arrays import FloatArray

MIXED_PX = 1.0
"""Motion of the image after which errors of edges by pixels that mix two surfaces are correlated by 1/e.
Physics: then an edge lies on other pixels."""


class Uncertainty(NamedTuple):
    """Covariance of a pose and its parts."""

    covariance: FloatArray
    """Covariance of (dp, dtheta), sensor axes, with all that the tracker assumes, shape (6, 6)."""
    parts: ErrorParts


def uncertainty(
    fit: JointFit,
    alone: FloatArray,
    whole: FloatArray,
    *,
    lines: Lines,
    bias_m: float,
    radius_px: float,
    wider: float,
) -> Uncertainty:
    """Return the uncertainty of an aligned pose.

    With the information I of all residuals, errors of the residuals whose information would be J cause the
    covariance I^-1 J I^-1. The true bias of the ranges causes an error because of its prior, and J is the
    prior's. Errors of edges are the same along a line (``edge_lines``). Edges beside saturated pixels are
    shifted towards their darker sides by a length that they share. The model's errors are those that the
    target's file declares.

    Args:
        fit: the aligned pose.
        alone: I^-1, shape (7, 7).
        whole: the same with the errors of the target's model, shape (7, 7).
        lines: sums of the lines of edges.
        bias_m: standard deviation of the prior of the bias.
        radius_px: radius of the target in the image, px.
        wider: factor on all covariances, above 1 where the target is larger than the image. Its longest
            edges and its faces reach across the image then, and an image that is 1/n of the target wide shows
            1/n of their lines. What all residuals share averages out over so many fewer.
    """
    white, of_sensor, of_image = (information_of(part, UNKNOWNS) for part in fit.evidence.parts)
    of_sensor[-1, -1] += bias_m**-2
    moved = alone @ gradient_of(fit.evidence.shift, UNKNOWNS)
    to_sensor = np.kron(np.eye(2), fit.state.pose.R)

    def turned(covariance: FloatArray) -> FloatArray:
        found: FloatArray = to_sensor @ (covariance[:6, :6] * wider) @ to_sensor.T
        return found

    return Uncertainty(
        turned(whole),
        ErrorParts(
            white=turned(alone @ white @ alone),
            of_sensor=turned(alone @ of_sensor @ alone + np.outer(moved, moved)),
            of_image=turned(jackknife(lines, alone, samples=alone @ of_image @ alone)),
            image_turn_rad=MIXED_PX / radius_px,
            of_model=turned(whole - alone),
        ),
    )
