"""Converts measurements to colours, grey tones and ellipsoids, independent of the viewer."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rpod_schemas.arrays import Array, FloatArray
from rpod_schemas.types import Float32Array

MILLIMETRES = 1000.0
SIGMAS = 3.0
"""Size of the ellipsoids and bands, in standard deviations."""
_STEP_M = 0.25
"""Step of the ends of a depth's colour scale, so that the colours do not flicker."""
_SAMPLED = 4
"""Step between the pixels, along rows and columns, from which a picture's percentiles are computed."""
_VIRIDIS = np.array(
    [[68, 1, 84], [65, 68, 135], [42, 120, 142], [34, 168, 132], [122, 209, 81], [253, 231, 37]], float
)
_COLOURS = np.column_stack(
    [np.interp(np.linspace(0.0, 5.0, 256), np.arange(6.0), band) for band in _VIRIDIS.T]
).astype(np.uint8)
_GAMMA = 0.6
_FAR_M = 65.0
"""Largest depth in metres that fits into 16 bits in millimetres."""


def depth_span_m(depth_m: Array) -> tuple[float, float]:
    """Return the depths at the ends of the colour scale; NaN in ``depth_m`` stands for no depth."""
    sampled = depth_m[::_SAMPLED, ::_SAMPLED] if depth_m.ndim == 2 else depth_m
    finite = sampled[np.isfinite(sampled)]
    if not finite.size:
        return 0.0, 1.0
    near, far = np.percentile(finite, (1, 99))
    near_m, far_m = _STEP_M * np.floor(near / _STEP_M), _STEP_M * np.ceil(far / _STEP_M)
    return float(near_m), float(max(far_m, near_m + _STEP_M))


def depth_mm(depth_m: Float32Array, span_m: tuple[float, float]) -> NDArray[np.uint16]:
    """Return depths in millimetres, limited to a span; without depth the far end, which is dark.

    They are limited because Rerun's native and web versions draw values outside a colour scale differently.
    Negative depths become 0.
    """
    near, far = span_m
    limited_m = np.nan_to_num(depth_m, nan=far).clip(near, min(far, _FAR_M)).clip(0.0)
    millimetres: NDArray[np.uint16] = (MILLIMETRES * limited_m).round().astype(np.uint16)
    return millimetres


def grey(amplitude: Array) -> NDArray[np.uint8]:
    """Return an image's grey tones, 0 to 255, scaled between its 1st and 99th percentile."""
    values = amplitude.astype(np.float32)
    low, high = np.nanpercentile(values[::_SAMPLED, ::_SAMPLED], (1, 99))
    share = np.nan_to_num((values - low) / max(high - low, 1e-6)).clip(0.0, 1.0)
    tones: NDArray[np.uint8] = (255.0 * share**_GAMMA).astype(np.uint8)
    return tones


def depth_colours(depth_m: Array, span_m: tuple[float, float]) -> NDArray[np.uint8]:
    """Return colours of depths, near ones bright, shape (N, 3)."""
    near, far = span_m
    share = ((far - depth_m) / (far - near)).clip(0.0, 1.0)
    return _COLOURS[(255.0 * share).astype(np.uint8)]


def ellipsoid(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return half axes, rising, shape (3,), and quaternion x, y, z, w of a covariance's 3 sigma ellipsoid."""
    variances, axes = np.linalg.eigh(covariance)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    return SIGMAS * np.sqrt(variances.clip(0.0)), Rotation.from_matrix(axes).as_quat()


def band(covariance: FloatArray) -> float:
    """Return three sigma along the worst axis of a covariance."""
    return float(SIGMAS * np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))
