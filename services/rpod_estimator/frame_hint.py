"""Describes what a frame measures, for the reason why no pose was found in it.

A first sensor often has another unit of length than the estimator is told, or looks past the target. No
method can tell: it finds too few pixels of the target, or none of its size. The distances themselves show it.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.types import Camera, SensorFrame

_NARROW_PX = 12.0
"""Width of the target in the image below which a first pose lacks pixels: a body covers at least a quarter of
the square of its length, and 40 pixels with depth are needed."""
_BESIDE = 0.1
"""Distance, over the target's radius, from which on a sensor may stand before the target: closer, all that it
measures lies inside the target's sphere, at a tenth of its radius."""
_PERCENT = (5.0, 95.0)


def described(data: SensorFrame, *, radius_m: float) -> str:
    """Return what a frame measures, and what may be wrong with it; empty for a frame without a range.

    Args:
        data: the frame.
        radius_m: radius of the target about its origin.
    """
    range_m = _ranges_m(data)
    if not len(range_m):
        return ""
    near_m, far_m = (float(value) for value in np.percentile(range_m, _PERCENT))
    hint = _hint(data.lens, near_m, far_m, radius_m)
    return f"it measures {near_m:{_form(near_m)}} to {far_m:{_form(far_m)}} m{hint}"


def _ranges_m(data: SensorFrame) -> NDArray[Any]:
    if data.lens is None:
        range_m: NDArray[Any] = np.linalg.norm(data.returns_m, axis=1)
        return range_m
    values = data.images[0].values
    measured_m: NDArray[Any] = values[np.isfinite(values) & (values > 0.0)]
    return measured_m


def _hint(lens: Camera | None, near_m: float, far_m: float, radius_m: float) -> str:
    unit = "source.depth_unit_m of the sensor" if lens is not None else "the unit of its points"
    if far_m < _BESIDE * radius_m:
        return f", inside the target, whose radius is {radius_m:.3g} m: check {unit}"
    if lens is None:
        return ""
    wide_px = 2.0 * radius_m * lens.fx / near_m
    if wide_px >= _NARROW_PX:
        return ""
    return (
        f", where the target is at most {wide_px:.1f} pixels wide: if the target is nearer, the depth is in "
        f"another unit: set {unit} (0.001 for millimetres)"
    )


def _form(length_m: float) -> str:
    """Return the format in which a length has three digits and no power of ten."""
    return ",.0f" if length_m >= 100.0 else ".3g"
