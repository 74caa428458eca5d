"""What light reaches a pixel in each sub-exposure.

A pixel sums its rays, so that edges mix by themselves; where all rays of a pixel meet the same triangle, one
through its centre stands for them. Which triangle a ray meets is taken from the middle of the exposure, how
far away it is from each sub-exposure's own pose: the ray is cut with the triangle's plane as it lies then. In
25 ms an outline moves by a fraction of a pixel, but ranges by millimetres, which the four samples see one
after the other.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import constants
from scipy.spatial.transform import RigidTransform

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd import PmdConfig
from rpod_sim_sensor.pmd.reflection import reflected_share
from rpod_target import Target

THETA_RAD = (0.0, math.pi, 0.5 * math.pi, 1.5 * math.pi)
"""Phases of the correlation in Q1..Q4, in the order with which Eqs. 1 and 3 hold as printed."""
SUN_RADIUS_RAD = 4.65e-3
"""Angular radius of the sun at one astronomical unit."""


class Surfaces(NamedTuple):
    """The target's triangles, as they lie and as they reflect."""

    planes: FloatArray
    """n / (n . v0), optical axes, shape (K + 1, T, 3): in the middle of the exposure, then in each of the K
    sub-exposures. A ray d meets the plane at 1 / (plane . d)."""
    normals: FloatArray
    """In the middle of the exposure, optical axes, shape (T, 3)."""
    diffuse: FloatArray
    """Albedo, shape (T,)."""
    f0: FloatArray
    """Specular reflectance, shape (T,)."""
    alpha2: FloatArray
    """Squared width of the lobe, shape (T,)."""


class Lights(NamedTuple):
    """The lamp at the camera and the sun, in electrons of one sub-exposure."""

    lamp_e: float
    """For a reflected share of 1/sr at 1 m."""
    lamp_radius_m: float
    rad_per_m: float
    """Phase over distance, 4 pi f / c."""
    wiggling_share: float
    theta_rad: tuple[float, ...]
    """Phase of the correlation in each sub-exposure."""
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
    return Lights(
        lamp_e=config.lamp_irradiance_W_m2 * config.electrons_per_radiance,
        lamp_radius_m=config.lamp.radius_m,
        rad_per_m=4.0 * math.pi * config.modulation_frequency_hz / constants.c,
        wiggling_share=config.pixel.wiggling_share,
        theta_rad=THETA_RAD,
        sun_e=irradiance * config.lens.sun_share * config.electrons_per_radiance,
        sun_direction=np.asarray(sun_W_m2, float) / (irradiance or 1.0),
    )


class Scene:
    """The target's triangles and materials, to be placed by pose."""

    def __init__(self, target: Target) -> None:
        materials = np.array([(m.diffuse, m.f0, m.roughness**4) for m in target.materials])
        self._diffuse, self._f0, self._alpha2 = materials[target.triangle_material].T.copy()
        self._normals = target.normals
        self._offsets_m = np.einsum("ti,ti->t", target.normals, target.triangles_m[:, 0])

    def placed(self, T_middle: RigidTransform, poses: Sequence[RigidTransform]) -> Surfaces:
        """Return the surfaces at T_optical_target in the middle of the exposure and in each sub-exposure."""
        every = [T_middle, *poses]
        normals = np.stack([pose.rotation.apply(self._normals) for pose in every])
        positions_m = np.stack([pose.translation for pose in every])
        offsets_m = self._offsets_m + np.einsum("kti,ki->kt", normals, positions_m)
        offsets_m[offsets_m == 0.0] = np.inf  # seen edge-on: no ray meets it
        planes = normals / offsets_m[..., None]
        return Surfaces(planes, normals[0], self._diffuse, self._f0, self._alpha2)


def collect(
    owners: NDArray[np.int32],
    rays: FloatArray,
    centres: FloatArray,
    surfaces: Surfaces,
    lights: Lights,
    *,
    modulated_e: NDArray[np.float32],
    charge_e: NDArray[np.float32],
) -> None:
    """Fill in what each pixel collects.

    Args:
        owners: triangle that each ray meets in the middle of the exposure, -1 for none, shape (n H, n W).
        rays: unit rays, optical axes, shape (3, n H, n W).
        centres: unit rays through the pixels' centres, shape (3, H, W).
        surfaces: the triangles.
        lights: lamp and sun.
        modulated_e: out, sum of S [cos(phi - theta_k) + h3 cos 3(phi - theta_k)], electrons, shape (H, W, K).
        charge_e: out, all electrons of a sub-exposure, S + B, shape (H, W).
    """
    _collect(owners, rays, centres, surfaces, lights, modulated_e, charge_e)


@njit(cache=True, nogil=True)
def spread_stray_light(modulated_e, charge_e, share):  # type: ignore[no-untyped-def]
    """Add a share of the image's mean light to every pixel, in place; shapes as in ``collect``."""
    height, width, count = modulated_e.shape
    stray_e = np.zeros(count + 1)
    for row in range(height):
        for column in range(width):
            for k in range(count):
                stray_e[k] += modulated_e[row, column, k]
            stray_e[count] += charge_e[row, column]
    stray_e *= share / (height * width)
    for row in range(height):
        for column in range(width):
            for k in range(count):
                modulated_e[row, column, k] += stray_e[k]
            charge_e[row, column] += stray_e[count]


@njit(cache=True, nogil=True, error_model="numpy")
def _collect(owners, rays, centres, surfaces, lights, modulated_e, charge_e):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    height, width = charge_e.shape
    n = owners.shape[0] // height
    modulated_e[:] = 0.0
    charge_e[:] = 0.0
    for row in range(height):
        for column in range(width):
            top, left = row * n, column * n
            if _is_uniform(owners, top, left, n):
                owner = owners[top, left]
                if owner >= 0:
                    x, y, z = centres[0, row, column], centres[1, row, column], centres[2, row, column]
                    _add(row, column, 1.0, owner, x, y, z, surfaces, lights, modulated_e, charge_e)
                continue
            for i in range(top, top + n):
                for j in range(left, left + n):
                    if owners[i, j] >= 0:
                        x, y, z = rays[0, i, j], rays[1, i, j], rays[2, i, j]
                        weight = 1.0 / (n * n)
                        _add(
                            row,
                            column,
                            weight,
                            owners[i, j],
                            x,
                            y,
                            z,
                            surfaces,
                            lights,
                            modulated_e,
                            charge_e,
                        )


@njit(cache=True, nogil=True)
def _is_uniform(owners, top, left, n):  # type: ignore[no-untyped-def]
    for i in range(top, top + n):
        for j in range(left, left + n):
            if owners[i, j] != owners[top, left]:
                return False
    return True


@njit(
    cache=True, nogil=True, error_model="numpy", inline="always"
)  # a call would count references for every array
def _add(row, column, weight, index, x, y, z, surfaces, lights, modulated_e, charge_e):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Add the electrons that come along the ray (x, y, z) to a pixel's."""
    planes, normal, sun = surfaces.planes, surfaces.normals[index], lights.sun_direction
    inverse = planes[0, index, 0] * x + planes[0, index, 1] * y + planes[0, index, 2] * z
    diffuse, f0, alpha2 = surfaces.diffuse[index], surfaces.f0[index], surfaces.alpha2[index]
    facing = -(normal[0] * x + normal[1] * y + normal[2] * z)
    side = 1.0 if facing > 0.0 else -1.0  # an open surface is seen from its inside too
    n_v = side * facing

    lamp_alpha2 = alpha2 + (0.5 * lights.lamp_radius_m * inverse) ** 2
    share = reflected_share(n_v, n_v, 1.0, diffuse, f0, lamp_alpha2)
    lamp_e = weight * lights.lamp_e * share
    for k in range(modulated_e.shape[2]):
        now = planes[1 + k, index, 0] * x + planes[1 + k, index, 1] * y + planes[1 + k, index, 2] * z
        if not 0.5 * inverse < now < 2.0 * inverse:  # all but edge-on, its plane may sweep over the camera
            now = inverse
        wave = math.cos(lights.rad_per_m / now - lights.theta_rad[k])
        third = wave * (4.0 * wave * wave - 3.0)  # cos 3x
        modulated_e[row, column, k] += lamp_e * now * now * (wave + lights.wiggling_share * third)
    charge_e[row, column] += lamp_e * inverse * inverse

    n_l = side * (normal[0] * sun[0] + normal[1] * sun[1] + normal[2] * sun[2])
    if lights.sun_e > 0.0 and n_l > 0.0:
        l_v = -(sun[0] * x + sun[1] * y + sun[2] * z)
        sun_alpha2 = alpha2 + (0.5 * SUN_RADIUS_RAD) ** 2
        share = reflected_share(n_l, n_v, l_v, diffuse, f0, sun_alpha2)
        charge_e[row, column] += weight * lights.sun_e * share
