"""The parts of the target that the pixels of a rendering show, each with its light.

A few rays for each pixel tell the place of an edge only to their distance. So a pixel beside another part has
more rays. They are tested only against the triangles that the rays in and around the pixel meet, which takes
a small part of the time of rays that are cast through the whole target.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.finer_rays import SAMPLES, FinerHits, Surface, finer_hits
from rpod_geometry.kernels import inlined_kernel, inner_kernel, kernel
from rpod_geometry.rays import RenderBuffers
from rpod_pose.pmd.rendering import Window, window_of
from rpod_schemas.arrays import Array, FloatArray
from rpod_schemas.types import Float32Array

IN_PHASE_RAD = 0.1
"""Largest difference of phase that counts as none. Numerics: the amplitude of their sum is a thousandth
smaller at most."""
SKY, SEVERAL = -1, -2
"""Index of the triangle for a pixel that shows none, and for one with several parts. Numerics: no triangle
has it."""


class Mixture(NamedTuple):
    """Contributions of the target's parts (plane faces or surfaces) to the pixels of a window; M in all."""

    window: Window
    pixel: NDArray[np.int32]
    """Row-major index of the pixel in the window, shape (M,)."""
    part: NDArray[np.int32]
    """Number of the part, shape (M,)."""
    light: Float32Array
    """Brightness that the part adds to the pixel, shape (M,)."""
    alone: NDArray[np.int32]
    """Number of the only part that a pixel shows, -1 for several or the sky, shape (rows, columns)."""
    free: Float32Array
    """Share of each pixel that the target does not cover, shape (rows, columns)."""


class Shape(NamedTuple):
    """The target at the pose of a rendering."""

    surface: Surface
    part: NDArray[np.int32]
    """Number of the part of each triangle, shape (T,)."""
    light: Float32Array
    """Brightness that a ray on each triangle adds, times its cubed range, shape (T,), m."""
    rad_per_m: FloatArray
    """Phase of light over the range of what it returns from, by modulation frequency, shape (F,), rad/m."""


@kernel
def mixture_of(rays: Array, hits: RenderBuffers, per_px: int, shape: Shape) -> Mixture:
    """Return the parts that the pixels of a rendering show.

    Args:
        rays: unit rays, sensor axes, shape (3, per_px * rows, per_px * columns).
        hits: their first hits, shape (per_px * rows, per_px * columns).
        per_px: number of rays for each pixel, along rows and columns.
        shape: the target.
    """
    window, (light, part), (range_m, triangle) = (
        window_of(hits.triangle, per_px),
        (shape.light, shape.part),
        hits,
    )
    one, several, most = _one_of(triangle, per_px, window, part)
    mixed = _mixed(finer_hits(rays, triangle, per_px, several, shape.surface), shape)
    end, part_of, light_of, sky = mixed.end, mixed.part, mixed.light, mixed.sky
    alone, free = np.full(one.shape, -1, np.int32), np.zeros(one.shape, np.float32)
    pixels, numbers, lights = np.empty(most, np.int32), np.empty(most, np.int32), np.empty(most, np.float32)
    count, m, n = 0, 0, 0
    for i in range(window.rows):
        for j in range(window.columns):
            only, pixel = one[i, j], i * window.columns + j
            if only == SKY:
                free[i, j] = 1.0
            elif only >= 0:
                row, column = per_px * (window.row + i), per_px * (window.column + j)
                pixels[count], numbers[count] = pixel, part[only]
                lights[count] = _light(range_m, triangle, light, (row, column), per_px)
                alone[i, j], count = part[only], count + 1
            else:
                alone[i, j] = part_of[n] if end[m] == n + 1 and not sky[m] else -1
                free[i, j] = sky[m] / SAMPLES**2
                while n < end[m]:
                    pixels[count], numbers[count], lights[count] = pixel, part_of[n], light_of[n]
                    count, n = count + 1, n + 1
                m += 1
    return Mixture(window, pixels[:count], numbers[:count], lights[:count], alone, free)


@inner_kernel
def _one_of(
    triangle: NDArray[np.int32], per_px: int, window: Window, part: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32], int]:
    """Return a triangle of the only part that rays in and around each pixel of a window meet.

    It has the shape (rows, columns). It is ``SKY`` if no ray meets any, and ``SEVERAL`` if the rays meet
    several parts. Row and column of these pixels follow, shape (P, 2), and an upper limit of the number of
    contributions of parts to all pixels.

    Args:
        triangle: triangle that each ray meets, -1 for none, shape (per_px * rows, per_px * columns).
        per_px: number of rays for each pixel, along rows and columns.
        window: the pixels.
        part: number of the part of each triangle, shape (T,).
    """
    one, (rows, columns) = np.empty((window.rows, window.columns), np.int32), triangle.shape
    several, count, alone = np.empty((one.size, 2), np.int32), 0, 0
    step = np.uint64(per_px)  # an index without a sign is not checked, so that the loops are vectorised
    left = per_px * window.column
    for i in range(window.rows):
        line, row = one[i], per_px * (window.row + i)
        first = triangle[row, left:]
        for j in range(np.uint64(window.columns)):
            line[j] = first[step * j]
        for v in range(max(row - 1, 0), min(row + per_px + 1, rows)):
            for k in range(-1, per_px + 1):
                skipped, begin = (1, left + per_px + k) if left + k < 0 else (0, left + k)
                number = min(window.columns - skipped, (columns - begin + per_px - 1) // per_px)
                own, of, other = first[per_px * skipped :], line[skipped:], triangle[v, begin:]
                for j in range(np.uint64(number)):
                    of[j] = of[j] if other[step * j] == own[step * j] else SEVERAL
        for j in range(window.columns):
            column = per_px * (window.column + j)
            if line[j] == SEVERAL and _one_part(triangle, part, row, column, per_px):
                line[j] = triangle[row, column]
            alone += line[j] >= 0
            if line[j] == SEVERAL:
                several[count, 0], several[count, 1] = window.row + i, window.column + j
                count += 1
    return one, several[:count], alone + SAMPLES * SAMPLES * count


@inner_kernel
def _one_part(
    triangle: NDArray[np.int32], part: NDArray[np.int32], row: int, column: int, per_px: int
) -> bool:
    """Return whether all rays in and around a pixel meet one part.

    Args:
        triangle: as for ``_one_of``, shape (per_px * rows, per_px * columns).
        part: as for ``_one_of``, shape (T,).
        row: row of the pixel's first ray.
        column: column of this ray.
        per_px: number of rays for each pixel, along rows and columns.
    """
    rows, columns = triangle.shape
    only = triangle[row, column]
    for i in range(max(row - 1, 0), min(row + per_px + 1, rows)):
        for j in range(max(column - 1, 0), min(column + per_px + 1, columns)):
            k = triangle[i, j]
            if k < 0 or only < 0 or part[k] != part[only]:
                return False
    return True


@inlined_kernel
def _light(
    range_m: Float32Array,
    triangle: NDArray[np.int32],
    light: Float32Array,
    first: tuple[int, int],
    per_px: int,
) -> float:
    """Return the mean brightness that a pixel's rays add.

    Args:
        range_m: range of the rays' first hits, shape (per_px * rows, per_px * columns), m.
        triangle: their triangles, same shape.
        light: as in ``Shape``, shape (T,), m.
        first: row and column of the pixel's first ray.
        per_px: number of rays for each pixel, along rows and columns.
    """
    (row, column), total = first, 0.0
    for i in range(row, row + per_px):
        for j in range(column, column + per_px):
            away_m = range_m[i, j]
            total += light[triangle[i, j]] / (away_m * away_m * away_m)
    return total / (per_px * per_px)


class _Mixed(NamedTuple):
    """Contributions of parts to P pixels with several parts; N in all."""

    end: NDArray[np.int32]
    """Number of contributions to this pixel and those before it, shape (P,)."""
    part: NDArray[np.int32]
    """Number of the part, shape (N,) or more."""
    light: Float32Array
    """Brightness that the part adds, shape (N,) or more."""
    sky: NDArray[np.int32]
    """Number of rays to the sky, shape (P,)."""


@inner_kernel
def _mixed(finer: FinerHits, shape: Shape) -> _Mixed:
    """Return the contributions of parts to pixels with several parts.

    Args:
        finer: hits of these pixels.
        shape: the target.
    """
    (triangle, inverse), light_of, part_of = finer, shape.light, shape.part
    number, share, rad_per_m = len(triangle), np.float32(1.0 / SAMPLES**2), shape.rad_per_m
    end, sky = np.empty(number, np.int32), np.zeros(number, np.int32)
    parts, lights = np.empty(triangle.size, np.int32), np.empty(triangle.size, np.float32)
    count, room = 0, np.empty((4, SAMPLES * SAMPLES))
    for pixel in range(number):
        first, before, slot = count, -1, count
        for n in range(SAMPLES * SAMPLES):
            met, near = triangle[pixel, n], inverse[pixel, n]
            if met < 0:
                sky[pixel] += 1
                continue
            if met != before:  # most rays meet the triangle that the ray before them meets
                before, slot = met, first
                while slot < count and parts[slot] != part_of[met]:
                    slot += 1
                if slot == count:
                    parts[slot], lights[slot], count = part_of[met], 0.0, count + 1
            lights[slot] += share * light_of[met] * near * near * near
        kept = np.float32(_kept(triangle, inverse, pixel, light_of, rad_per_m, room))
        for slot in range(first, count):
            lights[slot] *= kept
        end[pixel] = count
    return _Mixed(end, parts, lights, sky)


@inlined_kernel
def _kept(  # noqa: PLR0917
    triangle: NDArray[np.int32],
    inverse: Float32Array,
    pixel: int,
    light: Float32Array,
    rad_per_m: FloatArray,
    room: FloatArray,
) -> float:
    """Return the amplitude of a pixel over the sum of those of its rays.

    A pixel adds the phasors of what it shows. Parts that differ in range have different phases, so that their
    amplitudes do not add up. An image of several modulation frequencies has the mean of their amplitudes.

    Args:
        triangle: as in ``FinerHits``, shape (P, SAMPLES^2).
        inverse: as in ``FinerHits``, same shape.
        pixel: which of the pixels.
        light: as in ``Shape``, shape (T,), m.
        rad_per_m: as in ``Shape``, shape (F,), rad/m.
        room: overwritten, shape (4, SAMPLES^2).
    """
    low, high = np.float32(np.inf), np.float32(0.0)
    for n in range(SAMPLES * SAMPLES):
        near = inverse[pixel, n]
        low, high = (min(low, near) if near > 0.0 else low), max(high, near)
    kept, frequencies = 0.0, len(rad_per_m)
    if frequencies == 0 or not (1.0 / low - 1.0 / high) * rad_per_m[0] > IN_PHASE_RAD:
        return 1.0
    (amplitude, longer_m, real_of, imaginary_of), total, nearest_m = room, 0.0, 1.0 / high
    for n in range(np.uint64(SAMPLES * SAMPLES)):
        met, near = triangle[pixel, n], inverse[pixel, n]
        amplitude[n], longer_m[n] = 0.0, 0.0
        if met >= 0:
            amplitude[n], longer_m[n] = light[met] * near * near * near, 1.0 / near - nearest_m
        total += amplitude[n]
    for f in range(frequencies):
        for n in range(np.uint64(SAMPLES * SAMPLES)):  # without calls and branches, so that it is vectorised
            turns = longer_m[n] * (rad_per_m[f] / (2.0 * math.pi))
            sine, cosine = _sine_and_cosine(math.pi * (turns - np.rint(turns)))  # of half the angle
            real_of[n] = amplitude[n] * (1.0 - 2.0 * sine * sine)
            imaginary_of[n] = amplitude[n] * (2.0 * sine * cosine)
        real, imaginary = 0.0, 0.0
        for n in range(SAMPLES * SAMPLES):
            real, imaginary = real + real_of[n], imaginary + imaginary_of[n]
        kept += math.hypot(real, imaginary)
    return kept / total / frequencies if total > 0.0 else 1.0


@inlined_kernel
def _sine_and_cosine(angle_rad: float) -> tuple[float, float]:
    """Return sine and cosine of an angle of at most a quarter turn, by their series, within 6e-8."""
    x = angle_rad * angle_rad
    sine = 1 / 6 - x * (1 / 120 - x * (1 / 5040 - x * (1 / 362880 - x * (1 / 39916800))))
    cosine = 1 / 24 - x * (1 / 720 - x * (1 / 40320 - x * (1 / 3628800 - x * (1 / 479001600))))
    return angle_rad * (1.0 - x * sine), 1.0 - x * (0.5 - x * cosine)
