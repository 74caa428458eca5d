"""The distance field of a target, as compiled code reads it: trilinear, with its gradient."""

from numba import njit

from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array
from rpod_target import Target


@njit(cache=True, nogil=True)
def distance_and_gradient(x, y, z, values):  # type: ignore[no-untyped-def]
    """Return the trilinear distance and its gradient a cell, at a place in cells of the field.

    Outside the grid, both are those of its border.
    """
    nx, ny, nz = values.shape
    cx = min(max(x, 0.0), nx - 1.001)
    cy = min(max(y, 0.0), ny - 1.001)
    cz = min(max(z, 0.0), nz - 1.001)
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
    return (
        c0 + w * (c1 - c0),
        across_0 + w * (across_1 - across_0),
        c10 - c00 + w * (c11 - c01 - c10 + c00),
        c1 - c0,
    )


def field_arrays(target: Target) -> tuple[FloatArray, float, Float32Array]:
    """Return origin, spacing and values of a target's distance field, as the kernels take them."""
    field = target.require_field()
    return field.origin_m, field.spacing_m, field.values
