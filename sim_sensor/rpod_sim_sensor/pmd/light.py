"""What light reaches a pixel in each sub-exposure.

A pixel sums its rays, so that edges mix by themselves; where all rays of a pixel meet the same triangle, one
through its centre stands for them. Which triangle a ray meets is taken from the middle of the exposure, how
far away it is from each sub-exposure's own pose: the ray is cut with the triangle's plane as it lies then. In
25 ms an outline moves by a fraction of a pixel, but ranges by millimetres, which the samples see one after
the other.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import constants

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
"""Least cosine of a normal: a tilted patch may turn away from who sees its surface."""


class Lights(NamedTuple):
    """The lamp at the camera and the sun, in electrons of one sub-exposure."""

    lamp_e: float
    """For a reflected share of 1/sr at 1 m."""
    lamp_radius_m: float
    turns_per_m: FloatArray
    """Phase over distance, 2 f / c, in each sub-exposure, shape (K,)."""
    theta_turns: FloatArray
    """Phase of the correlation in each sub-exposure, shape (K,)."""
    wiggling_share: float
    sun_e: float
    """For a reflected share of 1/sr."""
    sun_direction: FloatArray
    """Unit vector in optical axes, shape (3,)."""


def lights(config: PmdConfig, sun_W_m2: FloatArray) -> Lights:
    """Return the lights of an exposure.

    Args:
        config: of the camera.
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
    modulated_e: Float32Array,
    charge_e: Float32Array,
) -> None:
    """Fill in what each pixel collects.

    Args:
        owners: triangle that each ray meets in the middle of the exposure, -1 for none, shape (n H, n W).
        rays: unit rays, optical axes, shape (3, n H, n W).
        centres: unit rays through the pixels' centres, shape (3, H, W).
        surfaces: the triangles.
        lights: lamp and sun.
        modulated_e: out, sum of S [cos(phi - theta_k) + h3 cos 3(phi - theta_k)], electrons, shape (K, H, W).
        charge_e: out, all electrons of a sub-exposure, S + B, shape (H, W).
    """
    _collect(owners, rays, centres, surfaces, lights, modulated_e, charge_e)


@njit(cache=True, nogil=True, error_model="numpy")
def _collect(owners, rays, centres, surfaces, lights, modulated_e, charge_e):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    height, width = charge_e.shape
    n = owners.shape[0] // height
    index = np.empty(width * n * n, np.uint32)
    columns = np.empty(width * n * n, np.uint32)
    work = np.empty((14, width * n * n))
    modulated_e[:] = 0.0
    charge_e[:] = 0.0
    for row in range(height):
        count = _fragments(owners, rays, centres, row, surfaces, index, columns, work)
        if count:
            _shade(index, work, count, surfaces, lights)
            for f in range(count):
                charge_e[row, columns[f]] += work[6, f]
            for k in range(modulated_e.shape[0]):
                _correlate(k, index, work, count, surfaces.planes, lights)
                for f in range(count):
                    modulated_e[k, row, columns[f]] += work[7, f]


@njit(cache=True, nogil=True, error_model="numpy")
def _fragments(owners, rays, centres, row, surfaces, index, columns, work):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """List which parts of a row's pixels see which triangle, and place the triangles; return how many."""
    width = centres.shape[2]
    n = owners.shape[1] // width
    placed, frame = surfaces.placed, surfaces.frame
    count = 0
    for column in range(width):
        first = count
        if _is_uniform(owners, row * n, column * n, n):
            if owners[row * n, column * n] >= 0:
                index[count], work[3, count] = owners[row * n, column * n], 1.0
                for axis in range(3):
                    work[axis, count] = centres[axis, row, column]
                count += 1
        else:
            count = _mixed(owners, rays, row * n, column * n, n, count, index, work)
        for f in range(first, count):
            columns[f] = column
            if placed[index[f]] != frame:
                place(index[f], surfaces)
    return count


@njit(cache=True, nogil=True)
def _is_uniform(owners, top, left, n):  # type: ignore[no-untyped-def]
    for i in range(top, top + n):
        for j in range(left, left + n):
            if owners[i, j] != owners[top, left]:
                return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _mixed(owners, rays, top, left, n, count, index, work):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Add a fragment for each triangle in a pixel, the mean of the rays that meet it; return the count."""
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
                work[:4, f] = 0.0
                count += 1
            for axis in range(3):
                work[axis, f] += rays[axis, i, j]
            work[3, f] += share
    for f in range(first, count):
        for axis in range(3):
            work[axis, f] *= share / work[3, f]
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _shade(index, work, count, surfaces, lights):  # type: ignore[no-untyped-def]
    """Fill in ``inverse``, ``lamp_e`` and ``charge`` of a row's fragments."""
    _look_up(index, work, count, surfaces)
    x, y, z, weight, inverse, lamp_e, charge = work[0], work[1], work[2], work[3], work[4], work[5], work[6]
    n_x, n_y, n_z, diffuse, f0, alpha2 = work[8], work[9], work[10], work[11], work[12], work[13]
    lamp, radius_m, sun_e = lights.lamp_e, lights.lamp_radius_m, lights.sun_e
    for f in range(count):
        n_v = max(n_x[f] * x[f] + n_y[f] * y[f] + n_z[f] * z[f], _GRAZING)
        lamp_alpha2 = alpha2[f] + (0.5 * radius_m * inverse[f]) ** 2
        lamp_e[f] = weight[f] * lamp * reflected_share(n_v, n_v, 1.0, diffuse[f], f0[f], lamp_alpha2)
        charge[f] = lamp_e[f] * inverse[f] * inverse[f]
    if sun_e == 0.0:
        return
    sun_x, sun_y, sun_z = lights.sun_direction
    for f in range(count):
        n_v = max(n_x[f] * x[f] + n_y[f] * y[f] + n_z[f] * z[f], _GRAZING)
        n_l = -(n_x[f] * sun_x + n_y[f] * sun_y + n_z[f] * sun_z)
        l_v = -(sun_x * x[f] + sun_y * y[f] + sun_z * z[f])
        sun_alpha2 = alpha2[f] + (0.5 * SUN_RADIUS_RAD) ** 2
        share = reflected_share(max(n_l, _GRAZING), n_v, l_v, diffuse[f], f0[f], sun_alpha2)
        charge[f] += weight[f] * sun_e * share if n_l > 0.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _look_up(index, work, count, surfaces):  # type: ignore[no-untyped-def]
    """Fill in ``inverse``, the normal and the material of a row's fragments: what a table has."""
    planes, normals, kinds = surfaces.planes, surfaces.far_normals, surfaces.material
    materials, R, t = surfaces.materials, surfaces.R_lattice_optical, surfaces.t_lattice_optical
    x, y, z, inverse, n_x, n_y, n_z = work[0], work[1], work[2], work[4], work[8], work[9], work[10]
    for f in range(count):
        i = index[f]
        inverse[f] = planes[i, 0, 0] * x[f] + planes[i, 0, 1] * y[f] + planes[i, 0, 2] * z[f]
        n_x[f], n_y[f], n_z[f] = normals[i, 0], normals[i, 1], normals[i, 2]
    for f in range(count):
        kind = kinds[index[f]]
        work[11, f], work[12, f], work[13, f] = materials[kind, 0], materials[kind, 1], materials[kind, 2]
        if materials[kind, 4] > 0.0:
            far_m = 1.0 / inverse[f]
            a, b, c = crinkled(
                x[f] * far_m, y[f] * far_m, z[f] * far_m, R, t, materials[kind, 3], materials[kind, 4]
            )
            n_x[f], n_y[f], n_z[f] = _unit(n_x[f] + a, n_y[f] + b, n_z[f] + c)


@njit(cache=True, nogil=True, error_model="numpy")
def _correlate(k, index, work, count, planes, lights):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Fill in ``modulated`` of a row's fragments in one sub-exposure."""
    x, y, z, inverse, lamp_e, out = work[0], work[1], work[2], work[4], work[5], work[7]
    turns_per_m, theta, h3 = lights.turns_per_m[k], lights.theta_turns[k], lights.wiggling_share
    for f in range(count):
        i = index[f]
        out[f] = planes[i, 1 + k, 0] * x[f] + planes[i, 1 + k, 1] * y[f] + planes[i, 1 + k, 2] * z[f]
    for f in range(count):  # apart from the look-up above, so that it is vectorised
        now = out[f]
        # all but edge-on, its plane may sweep over the camera
        now = now if 0.5 * inverse[f] < now < 2.0 * inverse[f] else inverse[f]
        wave = _cosine(turns_per_m / now - theta)
        third = wave * (4.0 * wave * wave - 3.0)  # cos 3x
        out[f] = lamp_e[f] * now * now * (wave + h3 * third)


@njit(cache=True, nogil=True, error_model="numpy")
def _unit(x, y, z):  # type: ignore[no-untyped-def]
    scale = 1.0 / math.sqrt(x * x + y * y + z * z)
    return x * scale, y * scale, z * scale


@njit(cache=True, nogil=True)
def _cosine(turns):  # type: ignore[no-untyped-def]
    """Return cos(2 pi turns) to 4e-9: a fitted odd polynomial for the sine of the rest to a quarter turn."""
    y = 0.25 - abs(turns - np.floor(turns + 0.5))
    y2 = y * y
    odd = -76.54965682009066 + y2 * 39.53581370784004
    odd = 6.283185159611162 + y2 * (-41.341654929342994 + y2 * (81.60099818259727 + y2 * odd))
    return y * odd
