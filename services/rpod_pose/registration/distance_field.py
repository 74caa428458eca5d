"""Trilinear interpolation in the distance field of a target, with its gradient, for compiled code."""

from typing import NamedTuple

import numpy as np

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_pose.registration.lie_group import Vector
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array
from rpod_target import Target, TargetError

FEWEST_NODES = 2
"""Least number of nodes along each axis of a field. Physics: they make one cell."""


class FieldArrays(NamedTuple):
    """Values on the nodes of a regular grid, in the form that kernels take; ``checked`` validates them."""

    origin_m: FloatArray
    """Position of the node [0, 0, 0], target axes, shape (3,), m."""
    spacing_m: float
    """Distance between neighbouring nodes along each axis."""
    values: Float32Array
    """Distances, m, or a function of them, shape (X, Y, Z), with two nodes or more along each axis."""


class FieldSample(NamedTuple):
    """The field at one place."""

    distance: float
    """Signed distance, positive outside, m."""
    gradient: Vector
    """Gradient of the distance, target axes; per cell or per metre, as the function says."""


@kernel
def distance_and_gradient(x: float, y: float, z: float, values: Float32Array) -> FieldSample:
    """Return the trilinear distance and its gradient per cell, at a place in cells of the field.

    The distance is interpolated along x, then y, then z between the eight nodes around the place; the
    gradient is the derivative of that polynomial. Outside the grid, both are those of its border. A place
    that is NaN counts as the border's first node, so that no index is ever outside of the grid.

    Args:
        x: cells from the first node along the first axis.
        y: cells from the first node along the second axis.
        z: cells from the first node along the third axis.
        values: ``FieldArrays.values``, shape (X, Y, Z).
    """
    nx, ny, nz = values.shape
    # max(0.0, NaN) is 0.0, as in Python; max(NaN, 0.0) would be NaN, which int turns into any number
    cx = min(max(0.0, x), nx - 1.001)
    cy = min(max(0.0, y), ny - 1.001)
    cz = min(max(0.0, z), nz - 1.001)
    i, j, k = int(cx), int(cy), int(cz)
    u, v, w = cx - i, cy - j, cz - k
    c000, c001 = values[i, j, k], values[i, j, k + 1]
    c010, c011 = values[i, j + 1, k], values[i, j + 1, k + 1]
    c100, c101 = values[i + 1, j, k], values[i + 1, j, k + 1]
    c110, c111 = values[i + 1, j + 1, k], values[i + 1, j + 1, k + 1]
    c00, c01 = c000 + u * (c100 - c000), c001 + u * (c101 - c001)
    c10, c11 = c010 + u * (c110 - c010), c011 + u * (c111 - c011)
    c0, c1 = c00 + v * (c10 - c00), c01 + v * (c11 - c01)
    across_0, across_1 = (
        c100 - c000 + v * (c110 - c010 - c100 + c000),
        c101 - c001 + v * (c111 - c011 - c101 + c001),
    )
    gradient = Vector(across_0 + w * (across_1 - across_0), c10 - c00 + w * (c11 - c01 - c10 + c00), c1 - c0)
    return FieldSample(c0 + w * (c1 - c0), gradient)


@inner_kernel
def field_at(field: FieldArrays, place: Vector) -> FieldSample:
    """Return the distance, m, and its gradient per metre at a place in target axes, m."""
    origin, per_m = field.origin_m, 1.0 / field.spacing_m
    sample = distance_and_gradient(
        (place.x - origin[0]) * per_m,
        (place.y - origin[1]) * per_m,
        (place.z - origin[2]) * per_m,
        field.values,
    )
    g = sample.gradient
    return FieldSample(sample.distance, Vector(g.x * per_m, g.y * per_m, g.z * per_m))


def field_arrays(target: Target) -> FieldArrays:
    """Return a target's distance field in the form that the kernels take.

    Raises:
        rpod_target.TargetError: the target has no distance field, or one with too few nodes.
    """
    field = target.require_field()
    return checked(target, FieldArrays(field.origin_m, float(field.spacing_m), field.values))


def checked(target: Target, field: FieldArrays) -> FieldArrays:
    """Return a field of a target unchanged, after a check that the kernels can interpolate in it.

    Raises:
        rpod_target.TargetError: the field has fewer than two nodes along an axis, or no positive spacing.
    """
    if min(field.values.shape) < FEWEST_NODES or not 0.0 < field.spacing_m < np.inf:
        nodes = " x ".join(str(count) for count in field.values.shape)
        reason = (
            f"{nodes} nodes {field.spacing_m:g} m apart; {FEWEST_NODES} or more are needed along each axis"
        )
        raise TargetError(target.source, "distance_field", f"{reason}: give the target a smaller spacing")
    return field
