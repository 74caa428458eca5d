"""Separation of a frame into the target's part and other things: by ranges alone, for any sensor.

Without a pose, each surface of the target's size is a place to search (``places``). With a pose, the target
is rendered. A ray that ends in front of the rendered surface meets a thing that hides the target, and gives
no information on the target. A ray that ends beyond the surface has passed the target.
"""

from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import RigidTransform

from rpod_geometry.rays import RayGrid
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array

BALL = 1.6
"""Radius, in radii of the target, around the median of its visible points that contains all of them. Hand: no
point is farther from the origin than one radius, and the median is one of a convex hull's inner points."""
ELSEWHERE_SHARE, ELSEWHERE = 0.02, 5
"""Largest share and number of a frame's ranges outside this ball that count as errors. Hand: stray and mixed
pixels are fewer, another body has more."""
BESIDE = 0.1
"""Distance outside the target's outline at which its surface should not continue, over its radius. Hand:
beyond the mixed pixels of the outline."""
NEIGHBOURS = np.ones((3, 3), np.uint8)
"""A ray and those around it. Physics: 3 x 3."""
AHEAD = 0.02
"""Cosine to the boresight below which a ray is not ahead, and its slope gives no direction. Numerics: a slope
of 50."""


class Label(IntEnum):
    """Class of a ray by what it shows."""

    KEPT = 0
    """The target, or nothing: the ray stays as it is."""
    HIDING = 1
    """Something in front of the target: the ray gives no information on the target."""
    BEYOND = 2
    """Something beside or behind the target: the ray does not meet the target."""


class Every(NamedTuple):
    """Rays of a sensor in an image: every ``stride``-th one in rows and in columns."""

    stride: int = 1
    offset: int = 0
    """Row and column of the first ray."""

    def nearest(self, other: "Every", count: int, most: int) -> NDArray[np.intp]:
        """Return the index of the ray nearest to each of ``count`` others, below ``most``, shape (count,)."""
        places = other.offset + other.stride * np.arange(count) - self.offset + self.stride // 2
        return np.clip(places // self.stride, 0, most).astype(np.intp)


EACH = Every()
"""All rays of a sensor. Numerics: the stride is 1."""


class Spans(NamedTuple):
    """Numbers of rays that a length spans."""

    rows: int
    columns: int

    @property
    def around(self) -> NDArray[np.uint8]:
        """All rays within the length of one, shape (2 rows + 1, 2 columns + 1)."""
        return np.ones((2 * self.rows + 1, 2 * self.columns + 1), np.uint8)

    def longer(self, rays: int) -> "Spans":
        """Return the spans with more rays."""
        return Spans(self.rows + rays, self.columns + rays)


@dataclass(frozen=True, eq=False)
class RangeImage:
    """Ranges of a frame along its rays."""

    grid: RayGrid
    range_m: Float32Array
    """Range of each ray, shape (rows, columns), 0 without one."""
    hidden: NDArray[np.bool_] | None = None
    """Rays that give no information on the target, because a known body is there, same shape; None if no body
    is known."""
    sigma_m: Float32Array | None = None
    """Standard deviation of each range's noise, same shape; None if it is not known."""
    every: Every = EACH
    """Which rays of the sensor these are."""

    def corrected(self, bias_m: float) -> "RangeImage":
        """Return the image without an error that all ranges share, m; rays without a range keep 0."""
        if bias_m == 0.0:
            return self
        shorter_m = np.maximum(self.range_m - np.float32(bias_m), np.float32(0.0))
        return replace(self, range_m=np.where(self.range_m > 0.0, shorter_m, np.float32(0.0)))

    @property
    def points_m(self) -> FloatArray:
        """Measured points, sensor axes, shape (rows, columns, 3)."""
        points_m: FloatArray = self.range_m[..., None] * self.grid.directions
        return points_m

    @cached_property
    def _spacing_rad(self) -> tuple[float, float]:
        """Angle from one row to the next, and from one column to the next, in the middle."""
        rows, columns = (count // 2 for count in self.range_m.shape)
        middle = self.grid.directions[max(rows - 1, 0) : rows + 1, max(columns - 1, 0) : columns + 1]
        down, across = (np.linalg.norm(middle[-1, -1] - each) for each in (middle[0, -1], middle[-1, 0]))
        return float(down), float(across)

    def rays_across(self, length_m: float, distance_m: float) -> Spans:
        """Return the number of rays that a length across the line of sight spans, from 1 to all."""
        spans = (
            int(np.clip(np.ceil(length_m / max(distance_m * spacing, 1e-9)), 1, most))
            for spacing, most in zip(self._spacing_rad, self.range_m.shape, strict=True)
        )
        return Spans(*spans)

    def in_view(self, points_m: FloatArray) -> float:
        """Return the share of points, sensor axes, shape (N, 3), that lie in the field of view."""
        x, y, z = self.grid.components
        if z.min() < AHEAD:
            rays = KDTree(self.grid.directions.reshape(-1, 3))
            unit = points_m / np.maximum(np.linalg.norm(points_m, axis=1, keepdims=True), 1e-12)
            away, _ = rays.query(unit, distance_upper_bound=max(self._spacing_rad))
            return np.count_nonzero(np.isfinite(away)) / max(len(points_m), 1)
        ahead = points_m[points_m[:, 2] > 0.0]
        u, v = ahead[:, 0] / ahead[:, 2], ahead[:, 1] / ahead[:, 2]
        across, down = x / z, y / z
        inside = (across.min() <= u) & (u <= across.max()) & (down.min() <= v) & (v <= down.max())
        return np.count_nonzero(inside) / max(len(points_m), 1)

    def shows_more_than(self, radius_m: float) -> bool:
        """Return whether the frame shows surfaces of a larger extent than a target of a radius, m."""
        points_m = self.points_m[self.range_m > 0.0]
        if not len(points_m):
            return False
        away = np.linalg.norm(points_m - np.median(points_m, axis=0), axis=1) > BALL * radius_m
        return bool(np.count_nonzero(away) > max(ELSEWHERE_SHARE * len(points_m), ELSEWHERE))

    def rays_beyond(self, reach_m: float, T_sensor_target: RigidTransform) -> int:
        """Return the largest number of connected rays that end farther than ``reach_m`` from the origin."""
        away_m = np.linalg.norm(self.points_m - T_sensor_target.translation, axis=-1)
        _, number = patches((self.range_m > 0.0) & (away_m > reach_m))
        return int(np.bincount(number)[1:].max(initial=0))


def with_bodies(labels: NDArray[np.uint8], hidden: NDArray[np.bool_] | None) -> NDArray[np.uint8]:
    """Return the labels, in which rays on known bodies, ``RangeImage.hidden``, are ``Label.HIDING``."""
    return labels if hidden is None else np.where(hidden, np.uint8(Label.HIDING), labels)


def upsampled(
    image: NDArray[Any], every: Every, shape: tuple[int, int], others: Every = EACH
) -> NDArray[Any]:
    """Return the values of an image on other rays: each ray gets the value of the nearest one.

    Args:
        image: values, shape (rows, columns).
        every: which rays of the sensor these are.
        shape: number of the other rows and columns.
        others: which rays these are; all of the sensor if left out.
    """
    if every == others and image.shape == shape:
        return image
    sizes = zip(shape, image.shape, strict=True)
    rows, columns = (every.nearest(others, count, last - 1) for count, last in sizes)
    return image.take(rows, axis=0).take(columns, axis=1)


def patches(rays: NDArray[np.bool_]) -> tuple[int, NDArray[np.intp]]:
    """Return the number of connected patches of rays without thin lines, and each ray's patch, 0 for none."""
    inner = np.asarray(cv2.erode(rays.view(np.uint8), NEIGHBOURS), np.uint8)
    count, numbers = cv2.connectedComponents(inner, connectivity=8)
    return count, np.asarray(numbers, np.intp).ravel()
