"""Lens distortion, plumb_bob or rational_polynomial as in CameraInfo, and its inverse."""

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.errors import DistortionError
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Camera

_NEWTON_STEPS, _WIDE_STEPS = 8, 16
"""Steps of Newton's method for a plumb_bob lens, and for the wide lenses of the rational polynomial."""
_NEWTON_TOLERANCE = 1e-9


def distort(slopes: FloatArray, camera: Camera) -> FloatArray:
    """Return the distorted slopes of the slopes x/z, y/z, shape (2, ...)."""
    x, y = slopes
    r2 = x * x + y * y
    radial, _ = _radial(r2, camera)
    p1, p2 = camera.coefficients[2:4]
    return np.stack(
        (
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        )
    )


def undistort(distorted: FloatArray, camera: Camera) -> FloatArray:
    """Return the slopes x/z, y/z, shape (2, ...), that the lens projects to ``distorted``, same shape.

    They are computed by Newton's method, since the usual fixed-point iteration fails on strong distortion.

    Raises:
        DistortionError: the distortion folds the image over itself there.
    """
    if not camera.distortion.any():
        return distorted
    slopes = distorted
    for _ in range(_WIDE_STEPS if camera.coefficients[5:].any() else _NEWTON_STEPS):
        slopes = slopes - _newton_step(slopes, distorted, camera)[0]
    step, upright = _newton_step(slopes, distorted, camera)
    wrong = ~(upright & (np.abs(step).max(axis=0) < _NEWTON_TOLERANCE))
    if wrong.any():
        x, y = distorted[:, wrong][:, 0]
        raise DistortionError(x * camera.fx + camera.cx, y * camera.fy + camera.cy)
    return slopes


def ray_cosines(camera: Camera) -> FloatArray:
    """Return z-depth divided by radial distance for each pixel, shape (height, width).

    Raises:
        DistortionError: the distortion folds the image over itself.
    """
    column, row = (np.arange(size, dtype=np.float64) for size in (camera.width, camera.height))
    x, y = np.meshgrid((column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy)
    distorted: FloatArray = np.stack((x, y))
    u, v = undistort(distorted, camera)
    cosines: FloatArray = 1.0 / np.sqrt(1.0 + u * u + v * v)
    return cosines


@np.errstate(all="ignore")  # divergence is detected by the last step
def _newton_step(
    slopes: FloatArray, distorted: FloatArray, camera: Camera
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the step towards ``distorted`` and whether the Jacobian is positive definite."""
    x, y = slopes
    radial, growth = _radial(x * x + y * y, camera)
    p1, p2 = camera.coefficients[2:4]
    xx = radial + growth * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    xy = growth * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    yy = radial + growth * y * y + 6.0 * p1 * y + 2.0 * p2 * x
    determinant = xx * yy - xy * xy
    dx, dy = distort(slopes, camera) - distorted
    step = np.stack((yy * dx - xy * dy, xx * dy - xy * dx)) / determinant
    return step, (determinant > 0.0) & (xx > 0.0)


def _radial(r2: FloatArray, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Return the radial factor at squared slopes, any shape, and its growth: d factor / dx = growth x."""
    k1, k2, _, _, k3, k4, k5, k6 = camera.coefficients
    below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / below
    growth = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3) - radial * (k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6))
    return radial, 2.0 * growth / below
