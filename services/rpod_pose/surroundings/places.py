"""Places in a frame at which the target may be: surfaces of its size that stand apart from larger things.

Planes that are larger than the target, such as walls, floors and tables, are left out.
"""

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from rpod_geometry.planes import fitted_plane, largest_plane
from rpod_pose.surroundings.separation import BALL, Label, RangeImage, upsampled, with_bodies
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array

LARGER = 2.5
"""Least extent of a plane that is no face of the target, over its radius. Physics: the extent of its faces is
at most 2."""
FLAT = 0.1
"""Largest distance of a point from its plane, over the target's radius. Hand: noise and bias of the ranges
are smaller, the target's depth is larger."""
PLANES, DRAWS, LEAST_PLANE = 8, 80, 0.03
"""Largest number of planes, number of random draws for each, and least share of the ranges on a plane.
Numerics: a room has six planes; 80 draws find a plane with a third of the ranges with a probability of 95 %.
Hand: the share."""
APART = 0.15
"""Least step in range between neighbouring rays on separate surfaces, over the target's radius. Hand: below
the depth of a body, above the noise of ranges."""
SLANTED = 4.0
"""Largest step in range between neighbouring rays on one surface, over their distance across. Hand: a face at
76 deg is still one surface."""
LEAST_SIZE, MOST_PLACES = 0.15, 6
"""Least half extent of a surface that may be the target, over its radius; largest number of places to search.
Hand: smaller surfaces are noise or remote. Numerics: the number is a budget."""
THIN = 0.2
"""Half the width of limbs that are removed from a surface larger than the target, over its radius. Hand: an
arm is thinner, a body thicker."""
SHIFTS = 3
"""Number of times that a ball moves to the median of the points in it. Numerics: a budget of computation."""
LEAST_RAYS = 8
"""Least number of rays on a surface that may be the target. Hand: fewer determine no pose."""


def places(
    image: RangeImage, radius_m: float, near_m: FloatArray | None = None
) -> Iterator[NDArray[np.bool_]]:
    """Yield the rays on each surface that may be the target, most rays first, shape (rows, columns).

    Args:
        image: ranges of a frame.
        radius_m: radius of the target's bounding sphere.
        near_m: expected position of the target, sensor axes, shape (3,); None if it is unknown.
    """
    points_m = image.points_m
    free = (image.range_m > 0.0) & ~_large_planes(image, points_m, radius_m)
    if near_m is not None:
        within = free & (np.linalg.norm(points_m - near_m, axis=-1) < BALL * radius_m)
        if np.count_nonzero(within) >= LEAST_RAYS:
            yield within
        return
    number, sizes = _labelled_surfaces(image, free, radius_m)
    inside = _surfaces_within_image(number, sizes, free)
    tried: set[bytes] = set()
    for place in _candidates(image, points_m, _surfaces(number, sizes, free), radius_m)[:MOST_PLACES]:
        together = _with_others(points_m, inside, place, radius_m)
        for each in (place,) if together is None else (together, place):
            if each.tobytes() not in tried:
                yield each
            tried.add(each.tobytes())


def _candidates(
    image: RangeImage, points_m: FloatArray, surfaces: list[NDArray[np.bool_]], radius_m: float
) -> list[NDArray[np.bool_]]:
    """Return the places on surfaces, those on the surfaces with most rays first.

    If a thin target continues in an arm, it has no thick part. Therefore parts of thin surfaces that the
    image's border cuts are candidates too, but come last.
    """
    found, thin = list[tuple[int, NDArray[np.bool_]]](), list[NDArray[np.bool_]]()
    for surface in surfaces:
        some = [
            place
            for place in _of_size(image, points_m, surface, radius_m)
            if np.count_nonzero(place) >= LEAST_RAYS
        ]
        if some and some[-1] is surface:  # first without its limbs, then with them
            found += [(int(np.count_nonzero(surface)), place) for place in some]
            if len(some) == 1 and at_border(surface):
                thin += _parts(points_m, surface, radius_m)
        else:
            found += [(int(np.count_nonzero(place)), place) for place in some]
    found.sort(key=lambda entry: -entry[0])
    return [place for _, place in found] + thin


def _with_others(
    points_m: FloatArray, free: NDArray[np.bool_], place: NDArray[np.bool_], radius_m: float
) -> NDArray[np.bool_] | None:
    """Return a place with other surfaces that may belong to the same target, since a body may have gaps.

    None if no other surface is near enough, or if the place itself extends beyond the given rays.

    Args:
        points_m: measured points, sensor axes, shape (rows, columns, 3).
        free: rays that may show the target, shape (rows, columns).
        place: rays on a surface, shape (rows, columns).
        radius_m: radius of the target's bounding sphere.
    """
    middle_m = np.median(points_m[place], axis=0)
    together = free & (np.linalg.norm(points_m - middle_m, axis=-1) < BALL * radius_m)
    more = np.count_nonzero(together) - np.count_nonzero(place)
    return together if more >= LEAST_RAYS and not (place & ~free).any() else None


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
        rays = np.zeros(left.shape, bool)
        rays[left] = chosen
        for wall in _walls(image, rays, radius_m):
            removed |= wall
        left &= ~rays
    return removed


def _walls(image: RangeImage, on_plane: NDArray[np.bool_], radius_m: float) -> Iterator[NDArray[np.bool_]]:
    """Yield the rays on a plane that belong to surfaces larger than the target.

    The plane of one of the target's faces also meets walls, the floor and other things, in narrow strips.
    Therefore the size of each surface on the plane is tested. If the largest one is a wall, the others are
    pieces of this wall between other things.
    """
    pieces = sorted(surfaces(image, on_plane, radius_m), key=np.count_nonzero, reverse=True)
    for number, surface in enumerate(pieces):
        points_m = image.points_m[surface]
        extent_m = 2.0 * np.linalg.norm(points_m - np.median(points_m, axis=0), axis=1)
        if np.quantile(extent_m, 0.9) > LARGER * radius_m:
            if number == 0:
                yield on_plane
                return
            yield surface


def _plane(points_m: FloatArray, generator: np.random.Generator, flat_m: float) -> NDArray[np.bool_] | None:
    """Return which points, shape (N, 3), lie on the plane with most of them; None without one."""
    few_m = points_m[:: max(1, len(points_m) // 1500)]
    drawn = largest_plane(few_m, flat_m, draws=DRAWS, generator=generator)
    if drawn is None:
        return None
    plane = fitted_plane(points_m[drawn.distances_m(points_m) < flat_m])
    on_plane: NDArray[np.bool_] = plane.distances_m(points_m) < flat_m
    return on_plane


def surfaces(image: RangeImage, free: NDArray[np.bool_], radius_m: float) -> list[NDArray[np.bool_]]:
    """Return the connected surfaces among some rays, shape (rows, columns) each."""
    return _surfaces(*_labelled_surfaces(image, free, radius_m), free)


def _surfaces(
    number: NDArray[np.intp], sizes: NDArray[np.intp], free: NDArray[np.bool_]
) -> list[NDArray[np.bool_]]:
    """Return ``surfaces`` of labelled rays: results of ``_labelled_surfaces``, and the free rays."""
    return [(number == n) & free for n in np.flatnonzero(sizes >= LEAST_RAYS)]


def _surfaces_within_image(
    number: NDArray[np.intp], sizes: NDArray[np.intp], free: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return the rays on surfaces that do not reach the image's border, shape (rows, columns).

    A single ray is no surface: its range is stray. Arguments are as for ``_surfaces``.
    """
    cut = np.concatenate([number[0], number[-1], number[:, 0], number[:, -1]])
    inside: NDArray[np.bool_] = free & (sizes[number] > 1) & ~np.isin(number, cut)
    return inside


def _labelled_surfaces(
    image: RangeImage, free: NDArray[np.bool_], radius_m: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the number of each ray's surface, (rows, columns), and the rays on each, (N,)."""
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
    return np.asarray(number, np.intp).reshape(free.shape), sizes


def _of_size(
    image: RangeImage, points_m: FloatArray, surface: NDArray[np.bool_], radius_m: float
) -> Iterator[NDArray[np.bool_]]:
    """Yield a surface if it may be the target, and the thick parts of one that may be larger.

    A surface that the image's border cuts may be larger: for example, an arm that holds the target extends
    into the image from outside. The thick parts are those that remain after thin limbs are removed.
    """
    whole = _fits(points_m[surface], radius_m)
    if whole and not at_border(surface):
        yield surface
        return
    distance_m = float(np.median(image.range_m[surface]))
    down, across = image.rays_across(THIN * radius_m, distance_m)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * across + 1, 2 * down + 1))
    count, number = cv2.connectedComponents(cv2.erode(surface.view(np.uint8), disc), connectivity=4)
    for n in range(1, count):
        bulk = cv2.dilate((number == n).view(np.uint8), disc).view(bool) & surface
        if _fits(points_m[bulk], radius_m):
            yield bulk
        elif not whole:
            yield from _parts(points_m, bulk, radius_m)
    if whole:
        yield surface


def at_border(surface: NDArray[np.bool_]) -> bool:
    """Return whether a surface, shape (rows, columns), reaches the border of the image."""
    return bool(surface[0].any() or surface[-1].any() or surface[:, 0].any() or surface[:, -1].any())


def spans_view(surface: NDArray[np.bool_]) -> bool:
    """Return whether a surface, shape (rows, columns), reaches two opposite borders of the image."""
    across = surface[0].any() and surface[-1].any()
    return bool(across or (surface[:, 0].any() and surface[:, -1].any()))


def _fits(points_m: FloatArray, radius_m: float) -> bool:
    """Return whether the extent of points, shape (N, 3), is possible for a visible target."""
    extent_m = np.linalg.norm(points_m - np.median(points_m, axis=0), axis=1)
    return bool(LEAST_SIZE * radius_m <= extent_m.max() and np.quantile(extent_m, 0.98) <= BALL * radius_m)


def _parts(points_m: FloatArray, surface: NDArray[np.bool_], radius_m: float) -> Iterator[NDArray[np.bool_]]:
    """Yield the rays in balls of the target's size on a larger surface, the nearest balls first."""
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
        upsampled(bound, image.every, fine.range_m.shape, fine.every)
        for bound in _bounds(image.range_m, place, APART * radius_m)
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
    return with_bodies(labels, fine.hidden)


def _bounds(
    range_m: Float32Array, place: NDArray[np.bool_], margin_m: float
) -> tuple[Float32Array, Float32Array]:
    """Return the least and largest range of a place on each ray and its neighbours; inf and 0 elsewhere."""
    around = np.ones((3, 3), np.uint8)
    nearest_m: Float32Array = cv2.erode(  # type: ignore[assignment]
        np.where(place, range_m, np.float32(np.inf)), around, borderValue=np.inf
    )
    farthest_m: Float32Array = cv2.dilate(  # type: ignore[assignment]
        np.where(place, range_m, np.float32(0.0)), around
    )
    return nearest_m - margin_m, np.where(farthest_m > 0.0, farthest_m + margin_m, farthest_m)
