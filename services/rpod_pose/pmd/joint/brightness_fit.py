"""How well an image agrees with a pose if the brightness of each face is free.

Materials are known only roughly, so that a rendering differs from the image at the right pose, too. Where the
brightness of each plane face is fitted to the image, what remains is what no brightness explains: places of
outlines and of changes inside. Two poses whose edges fit equally well are told apart by it.

The fit is non-negative: multiplicative steps of maximum likelihood (MLEM; L. A. Shepp, Y. Vardi, IEEE
Transactions on Medical Imaging 1(2), 1982) with the image's blur as the system.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import kernel
from rpod_pose.pmd.joint.edge_search import Patch
from rpod_schemas.arrays import Array
from rpod_schemas.types import Float32Array
from rpod_target import Target

ROUNDS = 3
"""Number of multiplicative steps. Numerics: a budget; the first one fits all of a face but its edges."""
UNEVEN = 0.15
"""Standard deviation of the brightness within a face, as a share. Hand: half of what surfaces that are not
Lambertian add to the spread of an albedo (``brightness``)."""
MOST_SIGMAS = 3.0
"""Greatest residual of a pixel or point that counts, in sigmas. Physics: one in 370 normal errors is
larger; another body or a shadow is an outlier."""
PLANES = 50.0
"""Number of steps in which normals and offsets of faces are told apart. Numerics: a degree, and 2 % of the
radius; more faces need more steps of the fit."""


class Rays(NamedTuple):
    """The M rays of a patch that meet the target at a pose."""

    pixel: NDArray[np.int32]
    """Row-major index of each ray's pixel, shape (M,)."""
    triangle: NDArray[np.int32]
    """Triangle that each ray meets, shape (M,)."""


def faces_of(target: Target) -> NDArray[np.int64]:
    """Return the number of the plane face of one material to which each triangle belongs, shape (T,)."""
    normals, triangles_m = np.asarray(target.normals), np.asarray(target.triangles_m)
    offsets = np.einsum("ni,ni->n", normals, triangles_m[:, 0]) / target.radius_m
    steps = np.rint(PLANES * np.column_stack((normals, offsets))).astype(np.int64)
    each: NDArray[np.int64] = np.unique(
        np.column_stack((steps, target.triangle_material)), axis=0, return_inverse=True
    )[1].ravel()
    return each


def misfit(
    patch: Patch, rays: Rays, light: Float32Array, face: NDArray[np.int64], *, clip: float, blur_px: float
) -> float:
    """Return minus the log likelihood of an image at a pose, with the brightness of each face fitted.

    Pixels that one blur covers share their errors: the sum is divided by the area 4 pi blur^2 of its
    autocorrelation.

    Args:
        patch: the image, smoothed.
        rays: rays that meet the target at the pose.
        light: brightness of each triangle at the pose, shape (T,), up to a factor.
        face: number of the face of each triangle, shape (T,).
        clip: greatest brightness of image and rendering, over the typical one.
        blur_px: standard deviation of the blur of image and rendering.
    """
    if not rays.pixel.size:
        return 0.0
    shape, most = patch.image.shape, clip * patch.typical
    faint = np.float32(0.5 * patch.least)  # what differs by less is no change of the image

    def shown() -> Float32Array:
        """Return the smoothed rendering, clipped like the image."""
        return _blurred(np.minimum(lit(light, rays, shape), np.float32(most)), blur_px)

    bright = lit(light, rays, shape)
    light = light * np.float32(patch.typical / np.median(bright[bright > 0.0]))
    for _ in range(ROUNDS):
        ratio = _blurred((patch.image + faint) / (shown() + faint), blur_px)
        multiply(light, face, rays, ratio)
    rendered = shown()
    deviation = np.hypot(UNEVEN * rendered, np.hypot(faint, patch.noise))
    residual = np.minimum(np.abs(patch.image - rendered) / deviation, MOST_SIGMAS)
    if patch.saturated.size:
        residual = residual[patch.saturated == 0]
    return float(0.5 * np.square(residual).sum() / (4.0 * np.pi * blur_px**2))


def _blurred(image: Array, blur_px: float) -> Float32Array:
    return cv2.GaussianBlur(image, (0, 0), blur_px).astype(np.float32, copy=False)


@kernel
def listed(triangle: NDArray[np.int32], per_px: int) -> Rays:
    """Return the rays that meet the target.

    Args:
        triangle: triangle that each ray meets, -1 for none, shape (per_px * rows, per_px * columns).
        per_px: number of rays for each pixel, along rows and columns.
    """
    rows, columns = triangle.shape
    pixel, met, count = np.empty(triangle.size, np.int32), np.empty(triangle.size, np.int32), 0
    for i in range(rows):
        for j in range(columns):
            if triangle[i, j] >= 0:
                pixel[count] = i // per_px * (columns // per_px) + j // per_px
                met[count] = triangle[i, j]
                count += 1
    return Rays(pixel[:count], met[:count])


@kernel
def lit(light: Float32Array, rays: Rays, shape: tuple[int, int]) -> Float32Array:
    """Return the sum of the brightness of the rays of each pixel.

    Args:
        light: brightness that a ray on each triangle adds, shape (T,).
        rays: rays that meet the target.
        shape: number of rows and columns of pixels.
    """
    image = np.zeros(shape[0] * shape[1], np.float32)
    for n in range(rays.pixel.size):
        image[rays.pixel[n]] += light[rays.triangle[n]]
    return image.reshape(shape)


@kernel
def multiply(light: Float32Array, face: NDArray[np.int64], rays: Rays, ratio: Float32Array) -> None:
    """Multiply the brightness of each face by the mean ratio of image over rendering on it.

    Args:
        light: brightness of each triangle, shape (T,), input and output.
        face: number of the face of each triangle, shape (T,).
        rays: rays that meet the target.
        ratio: image over rendering, blurred, shape (rows, columns).
    """
    sums, weights, ratios = np.zeros(face.max() + 1), np.zeros(face.max() + 1), ratio.ravel()
    for n in range(rays.pixel.size):
        k = rays.triangle[n]
        sums[face[k]] += light[k] * ratios[rays.pixel[n]]
        weights[face[k]] += light[k]
    for k in range(len(face)):
        if weights[face[k]] > 0.0:
            light[k] *= sums[face[k]] / weights[face[k]]
