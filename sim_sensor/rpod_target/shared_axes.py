"""Check that a model of a target has the target's axes; otherwise errors of poses have no meaning."""

from itertools import permutations, product

import numpy as np
from scipy.spatial.transform import Rotation

from rpod_schemas.arrays import FloatArray
from rpod_target.errors import TargetError
from rpod_target.joints import sampled
from rpod_target.target import Target

_FAR, _BETTER = 0.01, 0.5
"""Distance of a model's surface from the target's, over the longest side, above which the axes may differ;
and the share of this distance below which other axes are the right ones."""
_ALIKE = 1e-3
"""Difference of two such distances, over the longest side, below which the smaller turn is reported."""
_STEPS = 20
"""Steps of the search for the shift."""


def check_model(truth: Target, model: Target) -> None:
    """Check that a model of a target has the target's axes.

    The model's points are compared with the target's distance field, in the given axes and after quarter
    turns with a shift. A model of another shape is no error, since no other axes are much better then.

    Raises:
        TargetError: other axes fit the model to the target much better; the text names them.
    """
    if model.digest == truth.digest:
        return
    size_m = float(np.ptp(truth.triangles_m, axis=(0, 1)).max())
    points_m = model.model_points_m
    as_given_m = _distance_m(truth, points_m)
    if as_given_m < _FAR * size_m:
        return
    found = []
    for turn in _quarter_turns():
        turned_m = turn.apply(points_m)
        shift_m = _best_shift(truth, turned_m)
        found.append((_distance_m(truth, turned_m + shift_m), turn, shift_m))
    best_m = min(one[0] for one in found)
    alike = [one for one in found if one[0] <= best_m + _ALIKE * size_m]  # by symmetries
    _, turn, shift_m = min(alike, key=lambda one: one[1].magnitude())
    if best_m < _BETTER * as_given_m:
        euler = ", ".join(f"{angle:.0f}" for angle in turn.as_euler("ZYX", degrees=True))
        shift = ", ".join(f"{value:.3g}" for value in shift_m)
        raise TargetError(
            model.source,
            "",
            f"does not have the axes of {truth.name}: as given its surface is {as_given_m:.2g} m off in the "
            f"mean, and {best_m:.2g} m with T_target_part of all parts turned by euler_321_deg [{euler}] and "
            f"then moved by [{shift}] m; give both the same axes and origin",
        )


def _distance_m(truth: Target, points_m: FloatArray) -> float:
    """Return the mean distance of points, (N, 3), from the target's surface, m."""
    return float(np.abs(sampled(truth.require_field(), points_m)).mean())


def _best_shift(truth: Target, points_m: FloatArray) -> FloatArray:
    """Return the shift that brings points near the surface, by Gauss-Newton from equal middles, (3,), m."""
    corners_m = truth.triangles_m.reshape(-1, 3)
    middle_m = (corners_m.min(axis=0) + corners_m.max(axis=0)) / 2.0
    shift_m: FloatArray = middle_m - (points_m.min(axis=0) + points_m.max(axis=0)) / 2.0
    field = truth.require_field()
    step_m = field.spacing_m
    for _ in range(_STEPS):
        here_m = sampled(field, points_m + shift_m)
        slope = np.stack(
            [
                (sampled(field, points_m + shift_m + way) - sampled(field, points_m + shift_m - way))
                / (2.0 * step_m)
                for way in step_m * np.eye(3)
            ],
            axis=1,
        )
        shift_m -= np.linalg.lstsq(slope, here_m, rcond=None)[0]
    return shift_m


def _quarter_turns() -> list[Rotation]:
    """Return the 24 rotations that map the axes onto each other."""
    matrices = (
        np.eye(3)[list(order)] * np.array(signs)[:, None]
        for order in permutations(range(3))
        for signs in product((-1.0, 1.0), repeat=3)
    )
    return [Rotation.from_matrix(matrix) for matrix in matrices if np.linalg.det(matrix) > 0.0]
