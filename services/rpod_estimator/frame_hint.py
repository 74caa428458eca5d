"""Description of a frame's distances, for the reason why no pose was found in it.

A newly connected sensor often measures in another unit than the configuration states, or looks past the
target. A method cannot report this: it only finds too few pixels of the target, or nothing of its size. The
measured distances and the width of all measured points show it.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.types import Camera, SensorFrame

_NARROW_PX = 12.0
"""Least width of the target in the image for a first pose: a body covers at least a quarter of the square of
its length, and 40 pixels with depth are needed."""
_BESIDE = 0.1
"""Least plausible distance to the target, over its radius. If all measured points are closer, the sensor
would be inside the sphere around the target."""
_AHEAD = 0.6
"""Least mean component of the points' directions along the axis along which the sensor looks: the points are
within about 50 deg of it."""
_PERCENT = (5.0, 95.0)
_WIDE = 1.25
"""Largest width of all measured points, over the target's diameter, if only the target is in view and the
unit is right: no body is wider than its diameter, and a focal length may be slightly wrong."""
_SLIM = 0.4
"""Least width of all measured points, over the target's second longest side, if the whole target is in view
and the unit is right: from any direction a body is about as wide as that side."""


def described(data: SensorFrame, *, radius_m: float, side_m: float = 0.0) -> str:
    """Return the distances in a frame, and a hint at possible errors; empty for a frame without a range.

    Args:
        data: the frame.
        radius_m: radius of the target about its origin.
        side_m: second longest side of the target.
    """
    points_m = _points_m(data)
    if not len(points_m):
        return _negative_hint(data)
    range_m = points_m[:, 2] if data.lens is not None else np.linalg.norm(points_m, axis=1)
    near_m, far_m = (float(value) for value in np.percentile(range_m, _PERCENT))
    wide_m = float(np.ptp(np.percentile(points_m, _PERCENT, axis=0), axis=0).max())
    text = f"it measures {near_m:{_form(near_m)}} to {far_m:{_form(far_m)}} m"
    hint = (
        _axes_hint(data.lens, points_m)
        or _hint(data.lens, near_m, far_m, radius_m)
        or _size_hint(data.lens, wide_m, radius_m, side_m)
    )
    return f"{text}{hint}"


def _points_m(data: SensorFrame) -> NDArray[Any]:
    """Return points, sensor axes, shape (N, 3), m; the distortion of a lens is ignored.

    They have 64 bits: the square of a distance in a wrong unit may be too large or too small for 32.
    """
    if data.lens is None:
        returns: NDArray[Any] = data.returns_m.astype(np.float64)
        return returns
    values, lens = data.images[0].values, data.lens
    rows, columns = np.nonzero(np.isfinite(values) & (values > 0.0))
    depth_m = values[rows, columns].astype(np.float64)
    across = ((columns - lens.cx) / lens.fx, (rows - lens.cy) / lens.fy)
    points: NDArray[Any] = np.stack([*(each * depth_m for each in across), depth_m], axis=1)
    return points


def _negative_hint(data: SensorFrame) -> str:
    """Return a hint if depths are measured and none is above zero; else empty."""
    if data.lens is None:
        return ""
    values = data.images[0].values
    below_m = values[np.isfinite(values) & (values < 0.0)]
    if not below_m.size:
        return ""
    return (
        f"all {below_m.size:,} depths are below zero, {np.median(below_m):.3g} m in the median: let the "
        "driver send the depth along the viewing direction as a positive number"
    )


def _axes_hint(lens: Camera | None, points_m: NDArray[Any]) -> str:
    """Return a hint if the points of a LIDAR lie beside or behind it, not along z; else empty."""
    if lens is not None:
        return ""
    x, _, z = (points_m / np.linalg.norm(points_m, axis=1, keepdims=True)).mean(axis=0)
    turn = "turn the sensor, or the axes of its driver, so that the boresight points at the target"
    if z < -_AHEAD:
        return f" behind it: {turn}"
    if max(x, -x) < _AHEAD or z > 1.0 - _AHEAD:
        return ""
    if x < 0.0:
        return f" to the left of its boresight (z, or x of axes forward): {turn}"
    return (
        f" ahead along its x axis, not along z: set source.axes of the sensor to forward; where it is, {turn}"
    )


def _hint(lens: Camera | None, near_m: float, far_m: float, radius_m: float) -> str:
    unit = _field(lens)
    if far_m < _BESIDE * radius_m:
        return f", which is inside the target, whose radius is {radius_m:.3g} m: check {unit}"
    if lens is None:
        return ""
    wide_px = 2.0 * radius_m * lens.fx / near_m
    if wide_px >= _NARROW_PX:
        return ""
    return (
        f", where the target is at most {wide_px:.1f} pixels wide: if the target is nearer, the depth is in "
        f"another unit: set {unit} (0.001 for millimetres)"
    )


def _size_hint(lens: Camera | None, wide_m: float, radius_m: float, side_m: float) -> str:
    """Return a hint about the unit of length and the lens from the measured width; empty if none."""
    lens_too = "" if lens is None else ", or the focal length of camera_info is that of another mode"
    remedy = f"distances are in another unit: check {_field(lens)}{lens_too}"
    width = f", {wide_m:{_form(wide_m)}} m wide, while the target is"
    if wide_m > _WIDE * 2.0 * radius_m:
        return f"{width} {2.0 * radius_m:.3g} m wide at most: if nothing else is in view, {remedy}"
    if wide_m < _SLIM * side_m:
        return f"{width} {side_m:.3g} m wide or more: if all of it is in view, {remedy}"
    return ""


def _field(lens: Camera | None) -> str:
    return "source.depth_unit_m of the sensor" if lens is not None else "the unit of its points"


def _form(length_m: float) -> str:
    """Return the format in which a length has three digits and, below a thousand km, no power of ten."""
    return ",.0f" if 100.0 <= length_m < 1e6 else ".3g"
