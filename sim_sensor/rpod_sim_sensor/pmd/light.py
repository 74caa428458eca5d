"""Light that reaches each pixel in each sub-exposure.

A pixel sums the light of its rays, so that pixels at edges are mixed without further computation. If all rays
of a pixel hit the same triangle, one ray through the pixel's centre replaces them. Which triangle a ray hits
is determined for the middle of the exposure. The distance is computed for each sub-exposure, from the
triangle's plane at the pose of that time: in 25 ms an outline moves by a fraction of a pixel, but ranges
change by millimetres from sample to sample.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import constants

from rpod_geometry.kernels import inlined_kernel, inner_kernel, kernel
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.types import Float32Array
from rpod_sim_sensor.pmd.reflection import reflected_share
from rpod_sim_sensor.pmd.scene import Surfaces, crinkled, place

THETA_RAD = (0.0, math.pi, 0.5 * math.pi, 1.5 * math.pi)
"""Phases of the correlation in Q1..Q4, in the order with which Eqs. 1 and 3 hold as printed."""
SUN_RADIUS_RAD = 4.65e-3
"""Angular radius of the sun at one astronomical unit."""

_GRAZING = 1e-4
"""Least cosine between a normal and a ray, because a tilted patch may face away from the camera."""


class Lights(NamedTuple):
    """The lamp at the camera and the sun, in electrons of one sub-exposure."""

    lamp_e: float
    """Electrons from the lamp for a reflected share of 1/sr at 1 m."""
    lamp_radius_m: float
    turns_per_m: FloatArray
    """Phase over distance, 2 f / c, in each sub-exposure, shape (K,)."""
    theta_turns: FloatArray
    """Phase of the correlation in each sub-exposure, shape (K,)."""
    wiggling_share: float
    sun_e: float
    """Electrons from the sun for a reflected share of 1/sr."""
    sun_direction: FloatArray
    """Unit vector in optical axes, shape (3,)."""


class Fragments(NamedTuple):
    """The fragments of a row of pixels: each triangle in each pixel, one after the other."""

    columns: NDArray[np.uint32]
    """Column of the pixel."""
    triangle: NDArray[np.uint32]
    """Index of the triangle."""
    ray: FloatArray
    """Mean of the rays that hit the triangle, optical axes, shape (3, F)."""
    weight: FloatArray
    """Share of the pixel's rays that hit the triangle."""
    inverse: FloatArray
    """Inverse of the distance, 1/m."""
    normal: FloatArray
    """Normal away from the camera, optical axes, shape (3, F)."""
    material: FloatArray
    """Diffuse albedo, specular reflectance, squared width of the lobe, shape (3, F)."""
    lamp_e: FloatArray
    """The lamp's electrons at 1 m."""
    charge_e: FloatArray
    """All electrons."""
    modulated_e: FloatArray
    """Correlation with the modulation in one sub-exposure."""
    later: FloatArray
    """Inverse of the distance in each sub-exposure, 1/m, shape (K, F)."""

    @classmethod
    def of(cls, rays: int, sub_exposures: int) -> "Fragments":
        """Return buffers for a row with the given number of rays."""
        columns, triangle = np.empty((2, rays), np.uint32)
        ray, normal, material = np.empty((3, 3, rays))
        weight, inverse, lamp_e, charge_e, modulated_e = np.empty((5, rays))
        return cls(
            columns=columns,
            triangle=triangle,
            ray=ray,
            weight=weight,
            inverse=inverse,
            normal=normal,
            material=material,
            lamp_e=lamp_e,
            charge_e=charge_e,
            modulated_e=modulated_e,
            later=np.empty((sub_exposures, rays)),
        )


def lights(config: PmdConfig, sun_W_m2: FloatArray) -> Lights:
    """Return the lights of an exposure.

    Args:
        config: configuration of the camera.
        sun_W_m2: unit vector to the sun times its irradiance over the whole spectrum, optical axes.
    """
    irradiance = float(np.linalg.norm(sun_W_m2))
    frequencies_hz = np.array(config.frequencies_hz)
    return Lights(
        lamp_e=config.lamp_irradiance_W_m2 * config.electrons_per_radiance,
        lamp_radius_m=config.lamp.radius_m,
        turns_per_m=np.repeat(2.0 * frequencies_hz / constants.c, len(THETA_RAD)),
        theta_turns=np.tile(np.array(THETA_RAD) / (2.0 * math.pi), len(frequencies_hz)),
        wiggling_share=config.pixel.wiggling_share,
        sun_e=irradiance * config.lens.sun_share * config.electrons_per_radiance,
        sun_direction=np.asarray(sun_W_m2, float) / (irradiance or 1.0),
    )


def collect(
    owners: NDArray[np.int32],
    rays: FloatArray,
    centres: FloatArray,
    surfaces: Surfaces,
    lights: Lights,
    *,
    fragments: Fragments,
    modulated_e: Float32Array,
    charge_e: Float32Array,
) -> None:
    """Fill the electrons that each pixel collects.

    Args:
        owners: triangle that each ray hits in the middle of the exposure, -1 for none, shape (n H, n W).
        rays: unit rays, optical axes, shape (3, n H, n W).
        centres: unit rays through the pixels' centres, shape (3, H, W).
        surfaces: the triangles.
        lights: lamp and sun.
        fragments: buffers for a row.
        modulated_e: output, sum of S [cos(phi - theta_k) + h3 cos 3(phi - theta_k)], electrons, (K, H, W).
        charge_e: output, all electrons of a sub-exposure, S + B, shape (H, W).
    """
    _collect(_Rays(owners, rays, centres), surfaces, lights, fragments, modulated_e, charge_e)


class _Rays(NamedTuple):
    """The rays of all pixels, n x n each."""

    owners: NDArray[np.int32]
    """Triangle that each ray hits in the middle of the exposure, -1 for none, shape (n H, n W)."""
    directions: FloatArray
    """Unit rays, optical axes, shape (3, n H, n W)."""
    centres: FloatArray
    """Unit rays through the pixels' centres, shape (3, H, W)."""


class _Pixel(NamedTuple):
    """One pixel's block of rays."""

    top: int
    """First row of rays."""
    left: int
    """First column of rays."""
    n: int
    """Rows and columns of rays."""


@kernel
def _collect(  # noqa: PLR0917
    every: _Rays,
    surfaces: Surfaces,
    lights: Lights,
    fragments: Fragments,
    modulated_e: Float32Array,
    charge_e: Float32Array,
) -> None:
    """Fill the electrons that each pixel collects; arguments as in ``collect``."""
    modulated_e[:] = 0.0
    charge_e[:] = 0.0
    width = charge_e.shape[1]
    owned = np.empty((2, width), np.int32)
    for row in range(charge_e.shape[0]):
        count = _list(every, row, surfaces, fragments, owned)
        if count:
            _look_up(fragments, count, surfaces)
            _shade(fragments, count, lights)
            _add(fragments.charge_e, fragments.columns, count, charge_e[row])
            for k in range(modulated_e.shape[0]):
                _correlate(k, fragments, count, lights)
                _add(fragments.modulated_e, fragments.columns, count, modulated_e[k, row])


@inlined_kernel
def _list(every: _Rays, row: int, surfaces: Surfaces, fragments: Fragments, owned: NDArray[np.int32]) -> int:
    """List the fragments of a row of pixels, and place their triangles; return the number of fragments.

    ``owned`` is memory of shape (2, W).
    """
    centres, width = every.centres, every.centres.shape[2]
    n = every.owners.shape[1] // width
    placed, frame = surfaces.placed, surfaces.frame
    columns, index, ray, weight = fragments.columns, fragments.triangle, fragments.ray, fragments.weight
    _fill_owned(every.owners, row, n, owned)
    count = 0
    for column in range(width):
        if owned[1, column] < 0:
            continue
        first = count
        if owned[0, column] == owned[1, column]:
            index[count], weight[count] = owned[0, column], 1.0
            for axis in range(3):
                ray[axis, count] = centres[axis, row, column]
            count += 1
        else:
            count = _mixed(every, _Pixel(row * n, column * n, n), count, fragments)
        for f in range(first, count):
            columns[f] = column
            if placed[index[f]] != frame:
                place(index[f], surfaces)
    return count


@inner_kernel
def _fill_owned(owners: NDArray[np.int32], row: int, n: int, owned: NDArray[np.int32]) -> None:
    """Fill the least and the greatest triangle that the n x n rays of a row's pixels hit, shape (2, W)."""
    least, most = owned[0], owned[1]
    if n == 2:  # the usual number: a loop of fixed steps, which is vectorised
        above, below = owners[2 * row], owners[2 * row + 1]
        for column in range(least.size):
            a, b = above[2 * column], above[2 * column + 1]
            c, d = below[2 * column], below[2 * column + 1]
            least[column], most[column] = min(a, b, c, d), max(a, b, c, d)
        return
    for column in range(least.size):
        pixel = owners[row * n : (row + 1) * n, column * n : (column + 1) * n]
        least[column], most[column] = pixel.min(), pixel.max()


@inner_kernel
def _add(values: FloatArray, columns: NDArray[np.uint32], count: int, line: Float32Array) -> None:
    """Add the values of a row's fragments to its pixels, shape (W,), one stretch of neighbours at a time."""
    begin, one = np.uint64(0), np.uint64(1)
    while begin < count:
        first, end = np.uint64(columns[begin]), begin + one
        while end < count and columns[end] == first + (end - begin):
            end += one
        for f in range(begin, end):
            line[first + (f - begin)] += values[f]
        begin = end


@inlined_kernel
def _mixed(every: _Rays, pixel: _Pixel, count: int, fragments: Fragments) -> int:
    """Add a fragment for each triangle in a pixel, with the mean of its rays; return the count."""
    owners, rays, (top, left, n) = every.owners, every.directions, pixel
    index, ray, weight = fragments.triangle, fragments.ray, fragments.weight
    first, share = count, 1.0 / (n * n)
    for i in range(top, top + n):
        for j in range(left, left + n):
            if owners[i, j] < 0:
                continue
            f = first
            while f < count and index[f] != owners[i, j]:
                f += 1
            if f == count:
                index[f] = owners[i, j]
                ray[:, f] = 0.0
                weight[f] = 0.0
                count += 1
            for axis in range(3):
                ray[axis, f] += rays[axis, i, j]
            weight[f] += share
    for f in range(first, count):
        for axis in range(3):
            ray[axis, f] *= share / weight[f]
    return count


@inner_kernel
def _look_up(fragments: Fragments, count: int, surfaces: Surfaces) -> None:
    """Fill distance, normal and material of a row's fragments."""
    index, inverse, later = fragments.triangle, fragments.inverse, fragments.later
    x, y, z = fragments.ray[0], fragments.ray[1], fragments.ray[2]
    normal, material, planes = fragments.normal, fragments.material, surfaces.planes
    far_normals, materials, kinds = surfaces.far_normals, surfaces.materials, surfaces.material
    crinkles = False
    for f in range(count):
        i, kind = index[f], kinds[index[f]]
        inverse[f] = planes[i, 0, 0] * x[f] + planes[i, 0, 1] * y[f] + planes[i, 0, 2] * z[f]
        for axis in range(3):
            normal[axis, f], material[axis, f] = far_normals[i, axis], materials[kind, axis]
        crinkles |= materials[kind, 4] > 0.0
    for k in range(later.shape[0]):
        for f in range(count):
            i = index[f]
            later[k, f] = planes[i, 1 + k, 0] * x[f] + planes[i, 1 + k, 1] * y[f] + planes[i, 1 + k, 2] * z[f]
    if crinkles:
        _crinkle(fragments, count, surfaces)


@inner_kernel
def _crinkle(fragments: Fragments, count: int, surfaces: Surfaces) -> None:
    """Tilt the normals of a row's fragments of crinkled materials."""
    x, y, z = fragments.ray[0], fragments.ray[1], fragments.ray[2]
    inverse, normal = fragments.inverse, fragments.normal
    R, t = surfaces.R_lattice_optical, surfaces.t_lattice_optical
    index, kinds, materials = fragments.triangle, surfaces.material, surfaces.materials
    for f in range(count):
        kind = kinds[index[f]]
        per_m, tilt_rad = float(materials[kind, 3]), float(materials[kind, 4])
        if tilt_rad <= 0.0:
            continue
        far_m = 1.0 / inverse[f]
        a, b, c = crinkled(x[f] * far_m, y[f] * far_m, z[f] * far_m, R, t, per_m, tilt_rad)
        a, b, c = normal[0, f] + a, normal[1, f] + b, normal[2, f] + c
        normal[0, f], normal[1, f], normal[2, f] = _unit(a, b, c)


@inner_kernel
def _shade(fragments: Fragments, count: int, lights: Lights) -> None:
    """Fill the electrons of a row's fragments, without look-ups so that the loops are vectorised."""
    weight, inverse = fragments.weight, fragments.inverse
    lamp_e, charge_e = fragments.lamp_e, fragments.charge_e
    x, y, z = fragments.ray[0], fragments.ray[1], fragments.ray[2]
    n_x, n_y, n_z = fragments.normal[0], fragments.normal[1], fragments.normal[2]
    diffuse, f0, alpha2 = fragments.material[0], fragments.material[1], fragments.material[2]
    lamp, radius_m, sun_e = lights.lamp_e, lights.lamp_radius_m, lights.sun_e
    for f in range(count):
        n_v = max(n_x[f] * x[f] + n_y[f] * y[f] + n_z[f] * z[f], _GRAZING)
        lamp_alpha2 = alpha2[f] + (0.5 * radius_m * inverse[f]) ** 2
        lamp_e[f] = weight[f] * lamp * reflected_share(n_v, n_v, 1.0, diffuse[f], f0[f], lamp_alpha2)
        charge_e[f] = lamp_e[f] * inverse[f] * inverse[f]
    if sun_e == 0.0:
        return
    sun_x, sun_y, sun_z = lights.sun_direction
    for f in range(count):
        n_v = max(n_x[f] * x[f] + n_y[f] * y[f] + n_z[f] * z[f], _GRAZING)
        n_l = -(n_x[f] * sun_x + n_y[f] * sun_y + n_z[f] * sun_z)
        l_v = -(sun_x * x[f] + sun_y * y[f] + sun_z * z[f])
        sun_alpha2 = alpha2[f] + (0.5 * SUN_RADIUS_RAD) ** 2
        share = reflected_share(max(n_l, _GRAZING), n_v, l_v, diffuse[f], f0[f], sun_alpha2)
        charge_e[f] += weight[f] * sun_e * share if n_l > 0.0 else 0.0


@inner_kernel
def _correlate(k: int, fragments: Fragments, count: int, lights: Lights) -> None:
    """Fill the electrons of a row's fragments in sub-exposure k."""
    inverse, later = fragments.inverse, fragments.later[k]
    lamp_e, modulated_e = fragments.lamp_e, fragments.modulated_e
    turns_per_m, theta, h3 = lights.turns_per_m[k], lights.theta_turns[k], lights.wiggling_share
    for f in range(count):
        # the plane of a triangle seen almost edge-on may pass through the camera
        now = later[f] if 0.5 * inverse[f] < later[f] < 2.0 * inverse[f] else inverse[f]
        wave = _cosine(turns_per_m / now - theta)
        third = wave * (4.0 * wave * wave - 3.0)  # cos 3x
        modulated_e[f] = lamp_e[f] * now * now * (wave + h3 * third)


@inner_kernel
def _unit(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return a vector of length 1 along (x, y, z)."""
    scale = 1.0 / math.sqrt(x * x + y * y + z * z)
    return x * scale, y * scale, z * scale


@inner_kernel
def _cosine(turns: float) -> float:
    """Return cos(2 pi turns) to 4e-9: a fitted odd polynomial for the sine of the rest to a quarter turn."""
    y = 0.25 - abs(turns - np.floor(turns + 0.5))
    y2 = y * y
    odd = -76.54965682009066 + y2 * 39.53581370784004
    odd = 6.283185159611162 + y2 * (-41.341654929342994 + y2 * (81.60099818259727 + y2 * odd))
    return float(y * odd)
