"""View of a depth camera: the rays of its pixels, renderings of the target, and comparison with an image.

The model is rendered only on the coarse pixels, which are every ``stride``-th one along rows and columns,
exactly along their rays. This suffices to find which model points are hidden and whether a pose explains an
image.
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_geometry.errors import DistortionError
from rpod_geometry.kernels import kernel
from rpod_geometry.lens import distort
from rpod_geometry.rays import RayGrid, cast
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.methods import DepthImageConfig
from rpod_schemas.types import LENS_COEFFICIENTS, Camera, Float32Array, PmdFrame
from rpod_target import Target

FARTHEST_M = 1e3
"""Largest valid depth; the least one is ``NEAREST_M``. Physics: no camera has light for a kilometre."""
HIDDEN_M = 0.03
"""Least distance behind the surrounding rendered surface at which a point of the mock-up is hidden; for other
targets in proportion. Hand: a larger value keeps points behind thin parts, a smaller one loses points."""

STRAY_PARTS = 1, 2, 4, 8
"""Inverse widths of scattered light, over the image. Physics: light that is scattered over less than an
eighth of the image is the blur of an edge; octaves represent any width within a factor of 1.4."""
STRAY_STRIDE = 4
"""Distance of the pixels from which stray light is estimated. Numerics: the least part of an image has
hundreds of pixels, and their mean changes little over four."""
FOR_PLANE = 6
"""Least number of pixels from which the slope of a plane is subtracted. Numerics: a plane has three
parameters, and as many degrees of freedom remain."""
MEDIAN_OVER_MEAN = 1.25
"""Standard deviation of the median of normal errors over that of their mean. Physics: sqrt(pi / 2)."""


@dataclass(frozen=True)
class Agreement:
    """Agreement of a pose with a depth image."""

    explained_share: float
    """Weighted share of agreeing pixels among those where model or measurement show a surface."""
    cost_m2: float
    """Mean squared difference on these pixels. Differences are truncated at the tolerance, and pixels that
    show a surface only in model or measurement count with the tolerance."""


@dataclass(frozen=True, eq=False)
class DepthView:
    """The rays of one camera's pixels, created by ``of``."""

    camera: Camera
    slopes: FloatArray
    """x/z and y/z of every pixel's ray, undistorted, shape (height, width, 2)."""
    coarse: RayGrid
    """The rays of the coarse pixels, shape (rows, columns)."""
    stride: int
    """Distance from one coarse pixel to the next, px."""
    offset: int
    """Row and column of the first coarse pixel, px."""

    @classmethod
    def of(cls, camera: Camera, stride: int) -> "DepthView":
        """Return the view of a camera, which is cached from frame to frame.

        Raises:
            rpod_geometry.errors.DistortionError: the lens distortion cannot be inverted.
        """
        return _view(*_key(camera), stride)

    def rays(self, per_px: int) -> RayGrid:
        """Return ``per_px`` x ``per_px`` rays for each pixel of the image, in single precision."""
        return rays_of(self.camera, per_px)

    def project(self, points_m: FloatArray) -> FloatArray:
        """Return the pixels, column and row, of points in sensor axes with z > 0, shape (N, 2)."""
        u, v = distort(points_m[:, :2].T / points_m[:, 2], self.camera)
        return np.column_stack((u * self.camera.fx + self.camera.cx, v * self.camera.fy + self.camera.cy))

    def render(self, target: Target, T_sensor_target: RigidTransform) -> FloatArray:
        """Return the target's z-depth, m, on the coarse pixels, (rows, columns); inf where they miss it."""
        closed = target.field is not None
        hits = cast(self.coarse, target.triangles_m, T_sensor_target, cull_back_faces=closed)
        depth_m: FloatArray = hits.range_m * self.coarse.components[2]
        return depth_m

    def inside(self, pixels: FloatArray) -> NDArray[np.bool_]:
        """Return which pixels, column and row, shape (N, 2), lie in the image, shape (N,)."""
        size = np.array((self.camera.width, self.camera.height))
        within: NDArray[np.bool_] = np.all((pixels >= -0.5) & (pixels < size - 0.5), axis=1)
        return within

    def hidden(
        self, rendered_m: FloatArray, points_m: FloatArray, pixels: FloatArray, *, size: float
    ) -> NDArray[np.bool_]:
        """Return which points lie behind the rendered surface of all four coarse pixels around them, (N,).

        Args:
            rendered_m: z-depth of the target on the coarse pixels, shape (rows, columns), m.
            points_m: points, sensor axes, shape (N, 3).
            pixels: their column and row in the image, shape (N, 2).
            size: size of the target relative to the mock-up.
        """
        rows, columns = rendered_m.shape
        cell = np.floor((pixels - self.offset) / self.stride)
        column = np.clip(cell[:, 0], 0, columns - 2).astype(np.intp)
        row = np.clip(cell[:, 1], 0, rows - 2).astype(np.intp)
        around = [rendered_m[row + down, column + right] for down in (0, 1) for right in (0, 1)]
        behind: NDArray[np.bool_] = points_m[:, 2] > np.max(around, axis=0) + HIDDEN_M * size
        return behind


def rays_of(camera: Camera, per_px: int = 1) -> RayGrid:
    """Return ``per_px`` x ``per_px`` rays for each pixel, in single precision, cached from frame to frame.

    Raises:
        rpod_geometry.errors.DistortionError: the lens distortion cannot be inverted.
    """
    return _rays(*_key(camera), per_px)


_Size = tuple[int, int]
_Intrinsics = tuple[float, float, float, float]


def _key(camera: Camera) -> tuple[_Size, _Intrinsics, tuple[float, ...]]:
    """Return the key by which a camera's rays are cached: size, intrinsics and distortion."""
    intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy)
    return (camera.width, camera.height), intrinsics, tuple(camera.distortion)


def _camera(size: _Size, intrinsics: _Intrinsics, distortion: tuple[float, ...]) -> Camera:
    (width, height), (fx, fy, cx, cy) = size, intrinsics
    lens = np.array(distortion[:LENS_COEFFICIENTS])
    return Camera(width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy, distortion=lens)


@lru_cache(maxsize=8)
def _rays(size: _Size, intrinsics: _Intrinsics, distortion: tuple[float, ...], per_px: int) -> RayGrid:
    return RayGrid.pinhole(_camera(size, intrinsics, distortion), per_px).in_single_precision()


@lru_cache(maxsize=8)
def _slopes(
    size: _Size, intrinsics: _Intrinsics, distortion: tuple[float, ...]
) -> tuple[RayGrid, FloatArray]:
    """Return the rays of all pixels and their slopes, shape (height, width, 2), cached: they take long."""
    rays = RayGrid.pinhole(_camera(size, intrinsics, distortion))
    x, y, z = rays.components
    return rays, np.stack((x / z, y / z), axis=-1)


def offset_of(camera: Camera, stride: int) -> int:
    """Return the row and column, px, of the first of every ``stride``-th pixel of a camera."""
    return min(stride // 2, camera.width - 1, camera.height - 1)


@lru_cache(maxsize=32)
def _view(size: _Size, intrinsics: _Intrinsics, distortion: tuple[float, ...], stride: int) -> DepthView:
    camera = _camera(size, intrinsics, distortion)
    offset = offset_of(camera, stride)
    rays, slopes = _slopes(size, intrinsics, distortion)
    coarse = RayGrid(np.ascontiguousarray(rays.components[:, offset::stride, offset::stride]))
    return DepthView(camera, slopes, coarse, stride, offset)


@dataclass(frozen=True, eq=False)
class DepthImage:
    """One depth image with its view, created from a frame by ``usable_image``."""

    view: DepthView
    depth_m: Float32Array
    """z-depth, shape (height, width); NaN for invalid depth: 0, negative, infinite, ghosts."""
    coarse_m: Float32Array
    """z-depth on the coarse pixels, shape (rows, columns): the median of each pixel and its neighbours; NaN
    if most of them have no depth."""

    def points(self, count: int) -> FloatArray:
        """Return at most ``count`` points of the coarse pixels in sensor axes, shape (N, 3)."""
        view = self.view
        measured = np.flatnonzero(np.isfinite(self.coarse_m))
        if len(measured) > count:
            measured = measured[np.linspace(0, len(measured) - 1, count).astype(np.intp)]
        z = self.coarse_m.ravel()[measured].astype(np.float64)
        slopes = view.slopes[view.offset :: view.stride, view.offset :: view.stride].reshape(-1, 2)
        return np.column_stack((slopes[measured] * z[:, None], z))

    @cached_property
    def median_m(self) -> float:
        """Median depth of the coarse pixels; infinite if none has a depth."""
        measured = self.coarse_m[np.isfinite(self.coarse_m)]
        return float(np.median(measured)) if measured.size else math.inf

    def compare(
        self,
        target: Target,
        T_sensor_target: RigidTransform,
        *,
        tolerance_m: float,
        missing_weight: float,
    ) -> Agreement:
        """Return the agreement of the image with a rendering at a pose, on the coarse pixels.

        Args:
            target: the target.
            T_sensor_target: the pose.
            tolerance_m: largest difference of measured and rendered depth that agree.
            missing_weight: weight of a pixel without depth at a predicted surface.
        """
        measured, rendered = self.coarse_m, self.view.render(target, T_sensor_target)
        seen, predicted = np.isfinite(measured), np.isfinite(rendered)
        either, both = seen | predicted, seen & predicted
        if not either.any():
            return Agreement(0.0, tolerance_m**2)
        difference = np.full(measured.shape, tolerance_m)
        difference[both] = np.minimum(np.abs(measured[both] - rendered[both]), tolerance_m)
        weight = np.where(seen, 1.0, missing_weight)[either]
        total = max(weight.sum(), 1e-9)
        return Agreement(
            explained_share=float(weight @ (difference[either] < tolerance_m) / total),
            cost_m2=float(weight @ difference[either] ** 2 / total),
        )


def usable_image(frame: PmdFrame, config: DepthImageConfig) -> DepthImage | str:
    """Return a copy of a frame's depth without ghosts, or the reason why it cannot be used."""
    measured = np.isfinite(frame.depth_m) & (frame.depth_m > 0.0)
    if frame.amplitude is not None:
        measured &= frame.amplitude >= config.ghost_share * frame.amplitude.mean(dtype=np.float64)
    pixels = np.count_nonzero(measured)
    if pixels < config.min_pixels:
        return f"{pixels} pixels with depth, {config.min_pixels} needed"
    if frame.camera.distortion[LENS_COEFFICIENTS:].any():
        return f"distortion has {len(frame.camera.distortion)} coefficients, limit {LENS_COEFFICIENTS}"
    try:
        view = DepthView.of(frame.camera, config.stride_px)
    except DistortionError as error:
        return str(error)
    depth_m = np.where(measured, frame.depth_m, np.float32(np.nan))
    return DepthImage(view, depth_m, downsampled(depth_m, view.stride, view.offset))


def cosines_of(camera: Camera) -> Float32Array | None:
    """Return z-depth divided by radial distance of each pixel; None if the distortion has no inverse."""
    rays = rays_if_any(camera)
    return None if rays is None else rays.components[2]


def rays_if_any(camera: Camera) -> RayGrid | None:
    """Return the rays of all pixels; None if the distortion has no inverse."""
    if camera.distortion[LENS_COEFFICIENTS:].any():
        return None
    try:
        return rays_of(camera)
    except DistortionError:
        return None


def stray_light(frame: PmdFrame, share: float) -> Float32Array:
    """Return the largest amplitude that light scattered in the lens explains, shape (height, width).

    It is a share of the mean brightness around a pixel: of the largest mean over the whole image and over its
    parts in ``STRAY_PARTS``. It is unknown how far a lens scatters light, and a small target adds little to
    the mean of the whole image. Pixels without depth count as dark, unless they are as bright as those with
    depth: then they are saturated. The result is zero without depth or amplitude.
    """
    height, width = frame.depth_m.shape
    sparse = slice(None, None, STRAY_STRIDE)
    seen = frame.depth_m[sparse, sparse] > 0.0
    if frame.amplitude is None or not seen.any():
        return np.zeros((height, width), np.float32)
    light = frame.amplitude[sparse, sparse].astype(np.float32)
    light[~seen & (light < light[seen].mean())] = 0.0
    most = np.zeros_like(light)
    for part in STRAY_PARTS:
        side = max(max(light.shape) // part, 1)
        around = cv2.blur(light, (side, side)) if part > 1 else light.mean()
        np.maximum(most, around, out=most)
    limit: Float32Array = cv2.resize(np.float32(share) * most, (width, height))  # type: ignore[assignment]
    return limit


@kernel
def downsampled(depth: Float32Array, stride: int, offset: int) -> Float32Array:
    """Return the median of every ``stride``-th pixel of a depth image and its eight neighbours.

    A coarse pixel has depth if most of the nine have one, so that outlines do not move. The median reduces
    noise, which in sunlight exceeds the tolerance between model and measurement.

    Args:
        depth: z-depth, shape (height, width), m, NaN without depth.
        stride: distance from one pixel to the next, px, at least 1.
        offset: row and column of the first pixel.

    Returns:
        z-depth, shape (rows, columns), m, NaN if most of the nine have none.
    """
    height, width = depth.shape
    rows, columns = (height - offset - 1) // stride + 1, (width - offset - 1) // stride + 1
    coarse = np.full((rows, columns), np.nan, np.float32)
    for i in range(rows):
        for j in range(columns):
            row, column = offset + i * stride, offset + j * stride
            block = depth[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2].copy().ravel()
            valid = block[np.isfinite(block)]
            if 2 * valid.size > block.size:
                coarse[i, j] = np.median(valid)
    return coarse


@kernel
def variance_about_plane(pixels: FloatArray, count: int, steepest: float) -> float:
    """Return the variance of one pixel's depth, m2, without the slope of a plane.

    Args:
        pixels: column, row and depth of each pixel, shape (N, 3), px and m.
        count: number of pixels in use; they are the first ones.
        steepest: largest change of depth of a face from one pixel to the next, m.
    """
    if count < 2:
        return 0.0
    uu, uv, vv, uz, vz, zz = _central_moments(pixels, count)
    determinant = uu * vv - uv**2
    if count < FOR_PLANE or determinant <= 0.0:
        return max(zz, 0.0) / (count - 1)
    across, down = (vv * uz - uv * vz) / determinant, (uu * vz - uv * uz) / determinant
    share = steepest / max(math.hypot(across, down), steepest)
    across, down = share * across, share * down
    left = zz - 2.0 * (across * uz + down * vz) + across**2 * uu + 2.0 * across * down * uv + down**2 * vv
    return max(left, 0.0) / (count - 3)


class _Moments(NamedTuple):
    """Sums of products of columns u, rows v and depths z about their means."""

    uu: float
    uv: float
    vv: float
    uz: float
    vz: float
    zz: float


@kernel
def _central_moments(pixels: FloatArray, count: int) -> _Moments:
    """Return the moments of the first ``count`` pixels; arguments as for ``variance_about_plane``."""
    u_mean, v_mean, z_mean = 0.0, 0.0, 0.0
    for n in range(count):
        u_mean += pixels[n, 0] / count
        v_mean += pixels[n, 1] / count
        z_mean += pixels[n, 2] / count
    uu, uv, vv, uz, vz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for n in range(count):
        u, v, z = pixels[n, 0] - u_mean, pixels[n, 1] - v_mean, pixels[n, 2] - z_mean
        uu += u * u
        uv += u * v
        vv += v * v
        uz += u * z
        vz += v * z
        zz += z * z
    return _Moments(uu, uv, vv, uz, vz, zz)


@kernel
def noise_of_medians(
    depth: Float32Array, stride: int, offset: int, shape: tuple[int, int], steepest: float
) -> Float32Array:
    """Return the standard deviation of the medians of ``depth_view.downsampled``, m; 0 without depth.

    Args:
        depth: as for ``downsampled``, shape (height, width), m.
        stride: as for ``downsampled``.
        offset: as for ``downsampled``.
        shape: rows and columns that ``downsampled`` returned.
        steepest: largest change of a face's depth from one pixel to the next, over the depth.
    """
    sigma = np.zeros(shape, np.float32)
    height, width = depth.shape
    block = np.empty((9, 3))
    for i in range(shape[0]):
        for j in range(shape[1]):
            row, column, count = offset + i * stride, offset + j * stride, 0
            for m in range(max(row - 1, 0), min(row + 2, height)):
                for n in range(max(column - 1, 0), min(column + 2, width)):
                    if np.isfinite(depth[m, n]):
                        block[count, 0], block[count, 1], block[count, 2] = n, m, depth[m, n]
                        count += 1
            if count > 1:
                variance = variance_about_plane(block, count, steepest * block[:count, 2].mean())
                sigma[i, j] = MEDIAN_OVER_MEAN * np.sqrt(variance / count)
    return sigma
