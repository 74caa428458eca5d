"""Classes of a frame's rays at a pose of the target, which is rendered and compared with the ranges."""

from dataclasses import dataclass, replace
from math import asin, atan2, hypot, pi, tan
from typing import NamedTuple, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_geometry.rays import RayGrid, cast_pose
from rpod_geometry.windows import Window, window_around
from rpod_pose.surroundings.separation import (
    BESIDE,
    Label,
    RangeImage,
    Spans,
    patches,
    with_bodies,
)
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array
from rpod_target import Target

AROUND = 1.2
"""Radius, in radii of the target, beyond which a thing certainly extends out of the target's reach. Hand: a
thing that only touches the reach, with the noise of its ranges, is not counted."""
SIGMAS = 4.0
"""Least margin of ranges around a found pose, in their standard deviations. Physics: one in 16,000 normal
errors is larger."""
ROUNDING = 1e-4
"""Angle that is added to that of a ball in the field of view, rad. Numerics: above the rounding of slopes."""


@dataclass(frozen=True, eq=False)
class Sight:
    """Classes of all rays at a pose of the target."""

    labels: NDArray[np.uint8]
    """``Label`` of each ray, shape (rows, columns)."""
    inside: NDArray[np.bool_]
    """Rays that meet the target, like all rays around them."""
    visible_share: float
    """Share of the rays on the target that nothing hides."""
    measured: int
    """Number of rays on the target that nothing hides and that have a range."""
    measured_share: float
    """``measured`` divided by the number of all rays with a range."""
    elsewhere: int
    """Number of rays within the target's outline that have a range on another thing, no known body."""
    unexplained: int
    """Largest number of connected rays that end within the target's reach but not on its surface, on a thing
    that ends within this reach and so would be a detail of the target. Things at the image's border are not
    counted, since they may continue."""
    passed: int
    """Largest number of connected rays within the target's outline that end beyond its whole surface."""
    continued_share: float
    """Share of the rays beside its outline at which the target's surface continues outside."""


def _beside(
    met: NDArray[np.bool_], rendered_m: Float32Array, width: Spans
) -> tuple[NDArray[np.bool_], Float32Array]:
    """Return the rays a little outside the target's outline, and the ranges of the continued surface there.

    Ranges next to an outline are not used: a stereo camera widens near objects.
    """
    near, far = width.around, width.longer(1).around
    ring = _widened(met, far) & ~_widened(met, near)
    return ring, np.asarray(cv2.dilate(np.where(met, rendered_m, np.float32(0.0)), far), np.float32)


def _unexplained(
    image: RangeImage,
    explained: NDArray[np.bool_],
    radius_m: float,
    T_sensor_target: RigidTransform,
) -> int:
    """Return ``Sight.unexplained`` without the thin lines of rays that end between two surfaces."""
    ball = _window_of_ball(image.grid, T_sensor_target.translation, AROUND * radius_m)
    measured_m = image.range_m[ball]
    points_m = measured_m[..., None] * image.grid.directions[ball]
    away_m = np.linalg.norm(points_m - T_sensor_target.translation, axis=-1)
    around = (measured_m > 0.0) & ~explained[ball] & (away_m < AROUND * radius_m)
    if not around.any():
        return 0
    count, number = patches(around)
    inner = np.flatnonzero(number)
    farthest_m = np.zeros(count)
    np.maximum.at(farthest_m, number[inner], away_m.ravel()[inner])
    farthest_m[number[_border(image.range_m.shape)[ball].ravel()]] = np.inf
    sizes = np.bincount(number, minlength=count)
    return int(sizes[1:][farthest_m[1:] < radius_m].max(initial=0))


def _window_of_ball(grid: RayGrid, place_m: FloatArray, radius_m: float) -> Window:
    """Return a window with all rays that meet a ball, and those around them; empty if no ray meets it.

    Args:
        grid: the rays.
        place_m: centre of the ball, sensor axes, shape (3,), m.
        radius_m: radius of the ball.
    """
    bounds, (x, y, z) = grid.arrays, place_m.tolist()
    return (
        _lines_through(bounds.row_lower, bounds.row_upper, (y, z), radius_m),
        _lines_through(bounds.column_lower, bounds.column_upper, (x, z), radius_m),
    )


def _lines_through(
    lower: FloatArray, upper: FloatArray, place_m: tuple[float, float], reach_m: float
) -> slice:
    """Return the rows or columns of a grid whose rays may come within a reach of a place, and one more.

    Args:
        lower: bounds of their slopes, as in ``rpod_geometry.rays.Envelope``.
        upper: the same.
        place_m: coordinates of the place aside and ahead, m.
        reach_m: the reach.
    """
    distance_m = hypot(*place_m)
    if distance_m <= reach_m:
        return slice(0, len(lower))
    middle, half = atan2(*place_m), asin(reach_m / distance_m) + ROUNDING
    if max(middle + half, half - middle) >= 0.5 * pi:
        return slice(0, len(lower))
    first = int(np.searchsorted(upper, tan(middle - half)))
    last = int(np.searchsorted(lower, tan(middle + half), side="right"))
    return slice(max(first - 1, 0), last + 1)


def _border(shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return which rays lie at the border of an image of a shape, (rows, columns)."""
    border = np.ones(shape, bool)
    border[1:-1, 1:-1] = False
    return border


def _widened(rays: NDArray[np.bool_], shape: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return the rays within a shape, (rows, columns), of some rays."""
    return np.asarray(cv2.dilate(rays.view(np.uint8), shape), np.uint8).view(np.bool_)


def _share(part: NDArray[np.bool_], whole: NDArray[np.bool_]) -> float:
    """Return the number of rays in a part divided by that in the whole; 0 if the whole is empty."""
    return float(np.count_nonzero(part)) / max(int(np.count_nonzero(whole)), 1)


def _going_on(
    measured_m: Float32Array,
    rendered_m: Float32Array,
    around: NDArray[np.bool_],
    reach: Spans,
    margin_m: float,
) -> NDArray[np.bool_]:
    """Return the rays just outside the target's reach at which a surface continues at the target's range.

    The target ends within its reach. So such a surface belongs to another thing, for example an arm or a
    table, which touches the target or passes it.

    Args:
        measured_m: ranges of a frame, 0 without one, shape (rows, columns).
        rendered_m: ranges of the target at a pose, infinite beside it, same shape.
        around: rays within reach of the rendered target, same shape.
        reach: numbers of rays by which the target may be displaced.
        margin_m: error of its ranges.
    """
    farther = reach.longer(1).around
    met = np.isfinite(rendered_m)
    just_outside = _widened(met, farther) & ~around & (measured_m > 0.0)
    nearest_m = cv2.erode(rendered_m, farther, borderValue=np.inf) - margin_m
    farthest_m = cv2.dilate(np.where(met, rendered_m, np.float32(0.0)), farther) + margin_m
    past: NDArray[np.bool_] = just_outside & (nearest_m < measured_m) & (measured_m < farthest_m)
    return past


class Margin(NamedTuple):
    """Limits of the errors of a pose."""

    place_m: float
    """Across the line of sight."""
    range_m: float
    """Along it, with the error of a range."""


class _Compared(NamedTuple):
    """Rays of a window, compared with a rendered target; each array has the shape (rows, columns)."""

    measured_m: Float32Array
    """Ranges of the frame, 0 without one."""
    hidden: NDArray[np.bool_] | None
    """As in ``RangeImage``."""
    sigma_m: Float32Array | None
    """As in ``RangeImage``."""
    rendered_m: Float32Array
    """Ranges of the target, infinite beside it."""

    @classmethod
    def of(cls, image: RangeImage, target_m: Float32Array, window: Window) -> Self:
        """Return the rays in a window of an image, with the ranges of the rendered target."""
        hidden = None if image.hidden is None else image.hidden[window]
        sigma_m = None if image.sigma_m is None else image.sigma_m[window]
        return cls(image.range_m[window], hidden, sigma_m, target_m[window])


def _rendered(
    image: RangeImage, target: Target, T_sensor_target: RigidTransform
) -> tuple[Float32Array, Float32Array]:
    """Return the target's range on each ray, (rows, columns), inf beside it, and all those that meet it."""
    pose, closed = T_sensor_target.as_matrix(), target.field is not None
    R, t = pose[:3, :3].copy(), pose[:3, 3].copy()
    ball = _window_of_ball(image.grid, t, target.radius_m)
    grid = image.grid.block(*ball)
    range_m = np.empty(grid.components.shape[1:], np.float32)
    if range_m.size:
        cast_pose(grid, target.triangles_m, R, t, closed, range_m, np.empty(range_m.shape, np.int32))
    rendered_m = np.full(image.range_m.shape, np.inf, np.float32)
    rendered_m[ball] = range_m
    return rendered_m, range_m[np.isfinite(range_m)]


def with_target_at(
    image: RangeImage, target: Target, T_sensor_target: RigidTransform, margin: Margin
) -> Sight:
    """Return the class of each ray at a pose that may be wrong by up to a margin.

    Only rays around the rendered target are compared with it. All others are beyond it.
    """
    distance_m = float(np.linalg.norm(T_sensor_target.translation))
    rendered_m, met_m = _rendered(image, target, T_sensor_target)
    met = np.isfinite(rendered_m)
    typical_m = float(np.median(met_m)) if len(met_m) else 1.0
    reach = image.rays_across(margin.place_m, float(met_m.min(initial=distance_m)))
    beside = image.rays_across(BESIDE * target.radius_m, typical_m)
    window = window_around(met, Spans(*map(max, reach, beside)).longer(1))
    rays = _Compared.of(image, rendered_m, window)
    part = _classes(rays, (reach, beside), margin, target.radius_m)
    labels = np.full(met.shape, Label.BEYOND, np.uint8)
    inside = np.zeros(met.shape, np.bool_)
    labels[window], inside[window] = part.labels, part.inside
    labels = with_bodies(labels, image.hidden)
    return replace(
        part,
        labels=labels,
        inside=inside,
        measured_share=part.measured / max(int(np.count_nonzero(image.range_m > 0.0)), 1),
        unexplained=_unexplained(image, labels == Label.KEPT, target.radius_m, T_sensor_target),
    )


def _classes(rays: _Compared, spans: tuple[Spans, Spans], margin: Margin, radius_m: float) -> Sight:
    """Return the classes of the rays in a window around the target; ``unexplained`` is 0.

    Args:
        rays: the rays.
        spans: numbers of rays by which the target may be displaced, and of the rays beside its outline that
            are not used.
        margin: limits of the errors of the pose.
        radius_m: radius of the target.
    """
    measured_m, hidden, sigma_m, rendered_m = rays
    margin_m: FloatArray | float = margin.range_m
    if sigma_m is not None:
        margin_m = np.maximum(margin_m, SIGMAS * sigma_m)
    reach, (met, measured) = spans[0], (np.isfinite(rendered_m), measured_m > 0.0)
    shape = reach.around
    nearest_m = cv2.erode(rendered_m, shape, borderValue=np.inf) - margin_m
    farthest_m = cv2.dilate(np.where(met, rendered_m, np.float32(0.0)), shape) + margin_m
    around = _widened(met, shape)
    inside = cv2.erode(met.view(np.uint8), shape, borderValue=1).view(bool)
    labels = np.full(measured_m.shape, Label.KEPT, np.uint8)
    labels[~around] = Label.BEYOND
    labels[measured & around & (measured_m > farthest_m)] = Label.BEYOND
    labels[measured & around & (measured_m < nearest_m)] = Label.HIDING
    labels = with_bodies(labels, hidden)
    past = _going_on(measured_m, rendered_m, around, reach, margin.range_m)
    labels[~met & measured & (labels == Label.KEPT) & _widened(past, shape)] = Label.HIDING
    on_target = met & measured & (labels == Label.KEPT)
    elsewhere = met & measured & (labels != Label.KEPT)
    if hidden is not None:
        elsewhere &= ~hidden
    ring, outside_m = _beside(met, rendered_m, spans[1])
    beside_m = max(margin.range_m, BESIDE * radius_m)
    continued = ring & measured & (np.abs(measured_m - outside_m) < beside_m)
    return Sight(
        labels,
        inside,
        1.0 - _share(met & (labels == Label.HIDING), met),
        int(np.count_nonzero(on_target)),
        _share(on_target, measured),
        int(np.count_nonzero(elsewhere)),
        0,
        int(np.bincount(patches(inside & (labels == Label.BEYOND))[1])[1:].max(initial=0)),
        _share(continued, ring),
    )
