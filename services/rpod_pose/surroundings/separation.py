"""What of a frame may be the target's, and what belongs to other things: by ranges alone, for any sensor.

Without a pose, the frame is divided into connected surfaces. Planes that are larger than the target, such as
walls, floors and tables, are no part of it. Each other surface of the target's size is a place to search.

With a pose, the target is rendered. A ray that ends before the rendered surface meets something that hides
the target, and tells nothing of it. A ray that ends beyond it has passed the target.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import RigidTransform

from rpod_geometry.rays import RayGrid, cast
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array
from rpod_target import Target

BALL = 1.6
"""Radius, in radii of the target, around the median of its visible points that contains all of them: no point
is farther from the origin than one radius, and the median is one of a convex hull's inner points."""
ELSEWHERE_SHARE, ELSEWHERE = 0.02, 5
"""Share and number of a frame's ranges outside this ball up to which they are taken for errors."""
LARGER = 2.5
"""Least extent of a plane that is no face of the target, over its radius: its faces are at most 2."""
FLAT = 0.1
"""Greatest distance of a point from its plane, over the target's radius."""
PLANES, DRAWS, LEAST_PLANE = 8, 80, 0.03
"""Most planes, random draws for each, and least share of the ranges that one must explain."""
APART = 0.15
"""Step in range between neighbouring rays, over the target's radius, from which surfaces are separate."""
SLANTED = 4.0
"""Step in range between neighbouring rays, over their distance across, up to which a surface is one."""
LEAST_SIZE, MOST_PLACES = 0.15, 6
"""Least half extent of a surface that may be the target, over its radius; most places to search."""
THIN = 0.2
"""Half the width of limbs that are cut off a surface that is larger than the target, over its radius."""
SHIFTS = 3
"""Number of times that a ball is moved to the median of the points in it."""
BESIDE = 0.1
"""Distance outside the target's outline at which its surface should not go on, over its radius."""
AROUND = 1.2
"""Radius, in radii of the target, within which a thing that extends beyond the target's reach is seen."""
NEIGHBOURS = np.ones((3, 3), np.uint8)
"""A ray and those around it."""
MOST_RAYS = 24
"""Most rays by which an image is widened or narrowed."""
LEAST_RAYS = 8
"""Least number of rays on such a surface."""


class Label(IntEnum):
    """What a ray shows."""

    KEPT = 0
    """The target, or nothing: the ray stays as it is."""
    HIDING = 1
    """Something before the target: the ray tells nothing of it."""
    BEYOND = 2
    """Something beside or behind the target: the ray does not meet it."""


@dataclass(frozen=True, eq=False)
class RangeImage:
    """Ranges of a frame along its rays."""

    grid: RayGrid
    range_m: Float32Array
    """Range of each ray, shape (rows, columns), 0 without one."""
    hidden: NDArray[np.bool_] | None = None
    """Rays that tell nothing of the target, because a known body is there, same shape; None if no body is
    known."""

    @property
    def points_m(self) -> FloatArray:
        """Measured points, sensor axes, shape (rows, columns, 3)."""
        points_m: FloatArray = self.range_m[..., None] * self.grid.directions
        return points_m

    def rays_across(self, length_m: float, distance_m: float) -> int:
        """Return how many rays a length across the line of sight spans, 1 to ``MOST_RAYS``."""
        rows, columns = self.range_m.shape
        pair: FloatArray = self.grid.directions[rows // 2, columns // 2 - 1 : columns // 2 + 1]
        spacing_m = distance_m * float(np.linalg.norm(pair[-1] - pair[0]))
        return int(np.clip(np.ceil(length_m / max(spacing_m, 1e-9)), 1, MOST_RAYS))

    def in_view(self, points_m: FloatArray) -> float:
        """Return the share of points, sensor axes, shape (N, 3), that lie in the field of view."""
        x, y, z = self.grid.components
        ahead = points_m[points_m[:, 2] > 0.0]
        u, v = ahead[:, 0] / ahead[:, 2], ahead[:, 1] / ahead[:, 2]
        across, down = x / z, y / z
        inside = (across.min() <= u) & (u <= across.max()) & (down.min() <= v) & (v <= down.max())
        return np.count_nonzero(inside) / max(len(points_m), 1)

    def shows_more_than(self, radius_m: float) -> bool:
        """Return whether the frame shows more than a target of a radius, m, would fill."""
        points_m = self.points_m[self.range_m > 0.0]
        if not len(points_m):
            return False
        away = np.linalg.norm(points_m - np.median(points_m, axis=0), axis=1) > BALL * radius_m
        return bool(np.count_nonzero(away) > max(ELSEWHERE_SHARE * len(points_m), ELSEWHERE))


def places(
    image: RangeImage, radius_m: float, near_m: FloatArray | None = None
) -> Iterator[NDArray[np.bool_]]:
    """Yield the rays on surfaces that may be the target, those of most rays first, (rows, columns) each.

    Args:
        image: ranges of a frame.
        radius_m: radius of the target's bounding sphere.
        near_m: where the target is expected, sensor axes, shape (3,); None for anywhere.
    """
    points_m = image.points_m
    free = (image.range_m > 0.0) & ~_large_planes(image, points_m, radius_m)
    if near_m is not None:
        within = free & (np.linalg.norm(points_m - near_m, axis=-1) < BALL * radius_m)
        if np.count_nonzero(within) >= LEAST_RAYS:
            yield within
        return
    found = [
        place
        for surface in _surfaces(image, free, radius_m)
        for place in _of_size(image, points_m, surface, radius_m)
        if np.count_nonzero(place) >= LEAST_RAYS
    ]
    found.sort(key=lambda place: -np.count_nonzero(place))
    yield from found[:MOST_PLACES]


def _large_planes(image: RangeImage, points_m: FloatArray, radius_m: float) -> NDArray[np.bool_]:
    """Return the rays that end on planes larger than the target, shape (rows, columns)."""
    left, removed = image.range_m > 0.0, np.zeros(image.range_m.shape, bool)
    total, generator = np.count_nonzero(left), np.random.default_rng(0)
    for _ in range(PLANES):
        measured_m = points_m[left]
        if len(measured_m) < max(LEAST_PLANE * total, 3 * LEAST_RAYS):
            break
        chosen = _plane(measured_m, generator, FLAT * radius_m)
        if chosen is None or np.count_nonzero(chosen) < LEAST_PLANE * total:
            break
        on_plane_m = measured_m[chosen]
        extent_m = 2.0 * np.linalg.norm(on_plane_m - np.median(on_plane_m, axis=0), axis=1)
        rays = np.zeros(left.shape, bool)
        rays[left] = chosen
        if np.quantile(extent_m, 0.9) > LARGER * radius_m:
            removed |= rays
        left &= ~rays
    return removed


def _plane(points_m: FloatArray, generator: np.random.Generator, flat_m: float) -> NDArray[np.bool_] | None:
    """Return which points, shape (N, 3), lie on the plane with most of them (RANSAC); None without one."""
    few_m = points_m[:: max(1, len(points_m) // 1500)]
    a, b, c = few_m[generator.integers(len(few_m), size=(3, DRAWS))]
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    usable = lengths > 0.0
    if not usable.any():
        return None
    normals, a = normals[usable] / lengths[usable, None], a[usable]
    offsets_m = np.einsum("ni,ni->n", normals, a)
    best = int(np.argmax((np.abs(few_m @ normals.T - offsets_m) < flat_m).sum(axis=0)))
    near_m = points_m[np.abs(points_m @ normals[best] - offsets_m[best]) < flat_m]
    middle_m = near_m.mean(axis=0)
    normal = np.linalg.svd(near_m - middle_m, full_matrices=False)[2][2]
    on_plane: NDArray[np.bool_] = np.abs((points_m - middle_m) @ normal) < flat_m
    return on_plane


def _surfaces(image: RangeImage, free: NDArray[np.bool_], radius_m: float) -> list[NDArray[np.bool_]]:
    """Return the connected surfaces among some rays, shape (rows, columns) each."""
    range_m, index = image.range_m, np.arange(free.size).reshape(free.shape)
    pairs = []
    for one, other in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        directions = image.grid.directions
        across_m = range_m[one] * np.linalg.norm(directions[one] - directions[other], axis=-1)
        step_m = np.abs(range_m[one] - range_m[other])
        joined = free[one] & free[other] & (step_m < np.maximum(APART * radius_m, SLANTED * across_m))
        pairs.append(np.stack((index[one][joined], index[other][joined])))
    first, second = np.concatenate(pairs, axis=1)
    graph = coo_matrix((np.ones(len(first), bool), (first, second)), shape=(free.size, free.size))
    count, number = connected_components(graph, directed=False)
    sizes = np.bincount(number[free.ravel()], minlength=count)
    return [(number == n).reshape(free.shape) & free for n in np.flatnonzero(sizes >= LEAST_RAYS)]


def _of_size(
    image: RangeImage, points_m: FloatArray, surface: NDArray[np.bool_], radius_m: float
) -> Iterator[NDArray[np.bool_]]:
    """Yield a surface if it may be the target; of a larger one its bulky parts, without thin limbs."""
    if _fits(points_m[surface], radius_m):
        yield surface
        return
    distance_m = float(np.median(image.range_m[surface]))
    width = 2 * image.rays_across(THIN * radius_m, distance_m) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    count, number = cv2.connectedComponents(cv2.erode(surface.view(np.uint8), disc), connectivity=4)
    for n in range(1, count):
        bulk = cv2.dilate((number == n).view(np.uint8), disc).view(bool) & surface
        if _fits(points_m[bulk], radius_m):
            yield bulk
        else:
            yield from _parts(points_m, bulk, radius_m)


def _fits(points_m: FloatArray, radius_m: float) -> bool:
    """Return whether points, shape (N, 3), extend as far as those of a visible target may."""
    extent_m = np.linalg.norm(points_m - np.median(points_m, axis=0), axis=1)
    return bool(LEAST_SIZE * radius_m <= extent_m.max() and np.quantile(extent_m, 0.98) <= BALL * radius_m)


def _parts(points_m: FloatArray, surface: NDArray[np.bool_], radius_m: float) -> Iterator[NDArray[np.bool_]]:
    """Yield balls of the target's size on a larger surface, the nearest ones first."""
    left = surface.copy()
    for _ in range(MOST_PLACES):
        mine_m = points_m[left]
        if len(mine_m) < LEAST_RAYS:
            return
        middle_m = mine_m[np.argmin(np.linalg.norm(mine_m, axis=1))]
        for _ in range(SHIFTS):
            middle_m = np.median(mine_m[np.linalg.norm(mine_m - middle_m, axis=1) < radius_m], axis=0)
        part = left & (np.linalg.norm(points_m - middle_m, axis=-1) < radius_m)
        if not part.any():
            return
        yield part
        left &= ~part


def around_place(
    image: RangeImage, fine: RangeImage, place: NDArray[np.bool_], radius_m: float
) -> NDArray[np.uint8]:
    """Return the ``Label`` of each ray if the target is at a place.

    Args:
        image: ranges of few rays, among which the place was found.
        fine: ranges of many rays of the same frame.
        place: rays of ``image`` on the place, shape (rows, columns).
        radius_m: radius of the target's bounding sphere.

    Returns:
        The labels of the rays of ``fine``.
    """
    middle_m = np.median(image.points_m[place], axis=0)
    distance_m = float(np.linalg.norm(middle_m))
    near_m, far_m = (
        upsampled(bound, fine.range_m.shape) for bound in _bounds(image.range_m, place, APART * radius_m)
    )
    mine = (near_m <= fine.range_m) & (fine.range_m <= far_m)
    towards = fine.grid.directions @ (middle_m / distance_m) > np.cos(
        np.arcsin(min(1.0, BALL * radius_m / distance_m))
    )
    measured = fine.range_m > 0.0
    away_m = np.linalg.norm(fine.points_m - middle_m, axis=-1)
    unknown = measured & ((fine.range_m < distance_m) | (away_m < BALL * radius_m))
    labels = np.full(fine.range_m.shape, Label.BEYOND, np.uint8)
    labels[towards & unknown] = Label.HIDING
    labels[mine | (towards & ~measured)] = Label.KEPT
    return _with_bodies(labels, fine)


def _with_bodies(labels: NDArray[np.uint8], image: RangeImage) -> NDArray[np.uint8]:
    """Return the labels with those of the rays on known bodies."""
    return labels if image.hidden is None else np.where(image.hidden, np.uint8(Label.HIDING), labels)


def _bounds(
    range_m: Float32Array, place: NDArray[np.bool_], margin_m: float
) -> tuple[Float32Array, Float32Array]:
    """Return the least and greatest range of a place on each ray and those around it; inf and 0 elsewhere."""
    around = np.ones((3, 3), np.uint8)
    nearest_m: Float32Array = cv2.erode(  # type: ignore[assignment]
        np.where(place, range_m, np.float32(np.inf)), around, borderValue=np.inf
    )
    farthest_m: Float32Array = cv2.dilate(  # type: ignore[assignment]
        np.where(place, range_m, np.float32(0.0)), around
    )
    return nearest_m - margin_m, np.where(farthest_m > 0.0, farthest_m + margin_m, farthest_m)


def upsampled(image: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    """Return an image of every few rays on all of them: each takes the value of the nearest."""
    rows, columns = image.shape
    step = -(-shape[0] // rows)
    return image[
        np.ix_(
            np.minimum(np.arange(shape[0]) // step, rows - 1),
            np.minimum(np.arange(shape[1]) // step, columns - 1),
        )
    ]


@dataclass(frozen=True, eq=False)
class Sight:
    """What a pose of the target says of each ray."""

    labels: NDArray[np.uint8]
    """``Label`` of each ray, shape (rows, columns)."""
    inside: NDArray[np.bool_]
    """Rays that meet the target, and so do all around them."""
    visible_share: float
    """Share of the rays on the target that nothing hides."""
    unexplained: int
    """Greatest number of connected rays that end within the target's reach and not on it, of a thing that
    does not extend beyond this reach: a detail of the target itself."""
    passed: int
    """Greatest number of connected rays inside the target's outline that end beyond all of its surface."""
    continued_share: float
    """Share of the rays beside its outline at which the surface inside goes on outside."""


def _beside(
    image: RangeImage, met: NDArray[np.bool_], rendered_m: Float32Array, radius_m: float
) -> tuple[NDArray[np.bool_], Float32Array]:
    """Return the rays a little outside the target's outline, and the range at which its surface would go on.

    Ranges next to an outline are not used: a stereo camera widens what is near.
    """
    distance_m = float(np.median(rendered_m[met])) if met.any() else 1.0
    width = image.rays_across(BESIDE * radius_m, distance_m)
    near, far = (np.ones((2 * n + 1, 2 * n + 1), np.uint8) for n in (width, width + 1))
    ring = _widened(met, far) & ~_widened(met, near)
    return ring, np.asarray(cv2.dilate(np.where(met, rendered_m, np.float32(0.0)), far), np.float32)


def _unexplained(
    image: RangeImage,
    explained: NDArray[np.bool_],
    radius_m: float,
    T_sensor_target: RigidTransform,
) -> int:
    """Return ``Sight.unexplained`` without the thin lines of rays that end between two surfaces."""
    away_m = np.linalg.norm(image.points_m - T_sensor_target.translation, axis=-1)
    around = (image.range_m > 0.0) & ~explained & (away_m < AROUND * radius_m)
    count, number = _patches(around)
    farthest_m = np.zeros(count)
    np.maximum.at(farthest_m, number, np.where(around, away_m, 0.0).ravel())
    sizes = np.bincount(number, minlength=count)
    return int(sizes[1:][farthest_m[1:] < radius_m].max(initial=0))


def _patches(rays: NDArray[np.bool_]) -> tuple[int, NDArray[np.intp]]:
    """Return the number of connected patches of rays without thin lines, and each ray's patch, 0 for none."""
    inner = np.asarray(cv2.erode(rays.view(np.uint8), NEIGHBOURS), np.uint8)
    count, numbers = cv2.connectedComponents(inner, connectivity=8)
    return count, np.asarray(numbers, np.intp).ravel()


def _widened(rays: NDArray[np.bool_], shape: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return the rays within a shape, (rows, columns), of some rays."""
    return np.asarray(cv2.dilate(rays.view(np.uint8), shape), np.uint8).view(np.bool_)


def _share(part: NDArray[np.bool_], whole: NDArray[np.bool_]) -> float:
    """Return the number of rays in a part over that in the whole; 0 for none."""
    return float(np.count_nonzero(part)) / max(int(np.count_nonzero(whole)), 1)


class Margin(NamedTuple):
    """How far a pose may be off."""

    place_m: float
    """Across the line of sight."""
    range_m: float
    """Along it, with the error of a range."""


def with_target_at(
    image: RangeImage, target: Target, T_sensor_target: RigidTransform, margin: Margin
) -> Sight:
    """Return what a pose says of each ray, if it is wrong by up to a margin."""
    margin_m = margin.range_m
    closed = target.field is not None
    hits = cast(image.grid, target.triangles_m, T_sensor_target, cull_back_faces=closed)
    rendered_m, measured_m = hits.range_m, image.range_m
    met, measured = hits.triangle >= 0, image.range_m > 0.0
    reach = image.rays_across(margin.place_m, float(np.linalg.norm(T_sensor_target.translation)))
    shape = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    nearest_m = cv2.erode(rendered_m, shape, borderValue=np.inf) - margin_m
    farthest_m = cv2.dilate(np.where(met, rendered_m, np.float32(0.0)), shape) + margin_m
    around = _widened(met, shape)
    inside = cv2.erode(met.view(np.uint8), shape, borderValue=1).view(bool)
    labels = np.full(measured_m.shape, Label.KEPT, np.uint8)
    labels[~around] = Label.BEYOND
    labels[measured & around & (measured_m > farthest_m)] = Label.BEYOND
    labels[measured & around & (measured_m < nearest_m)] = Label.HIDING
    labels = _with_bodies(labels, image)
    hidden = met & (labels == Label.HIDING)
    ring, outside_m = _beside(image, met, rendered_m, target.radius_m)
    continued = ring & measured & (np.abs(measured_m - outside_m) < max(margin_m, BESIDE * target.radius_m))
    return Sight(
        labels,
        inside,
        1.0 - _share(hidden, met),
        _unexplained(image, labels == Label.KEPT, target.radius_m, T_sensor_target),
        int(np.bincount(_patches(inside & (labels == Label.BEYOND))[1])[1:].max(initial=0)),
        _share(continued, ring),
    )
