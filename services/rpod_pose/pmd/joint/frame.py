"""A PMD frame prepared for the joint tracker: points of its depth, and its amplitude around the target."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from rpod_geometry.errors import DistortionError
from rpod_geometry.kernels import kernel
from rpod_geometry.rays import NEAREST_M, GridArrays
from rpod_pose.pmd.depth_view import DepthView, stray_light
from rpod_pose.pmd.joint.brightness.amplitude_noise import noise_of, noise_of_change, typical_of
from rpod_pose.pmd.joint.depth_points import DepthImages, coarse_ranges
from rpod_pose.pmd.joint.edge_search import NOT_SATURATED, CoarsePixels, Lens, Patch
from rpod_pose.registration.lie_group import PoseArrays
from rpod_pose.surroundings.places import SLANTED
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.joint import JointEdgeConfig, JointTuning
from rpod_schemas.types import LENS_COEFFICIENTS, Camera, Float32Array, PmdFrame

MARGIN_PX = 16
"""Margin around the projection of the target's bounding sphere. Hand: it covers the error of a prediction and
the reach of the search for edges."""
FILLED = 0.4
"""Typical share of the square around its bounding sphere that a target fills. Hand: it sets the stride only;
0.4 is half of a disc's share."""
STRIDES_PX = 3, 8
"""Least and greatest distance of two points in the image. Numerics: the blocks of nine pixels of two points
do not overlap; with a larger distance, small details have no point."""
SPARSE = 4
"""Stride of the pixels in the image's mean and in the count of depth pixels. Numerics: a budget of
computation."""
FINE_PX, FINE_RAYS = 70_000, 2
"""Largest number of pixels of a patch that is rendered with several rays for each pixel, and the number of
these rays along rows and columns, which meet thin parts. Numerics: a budget; in a larger patch, a pixel is
small on the target. Pixels that show edges have more (``finer_rays``)."""
_STEEPEST_RAD = np.radians(89.0)
"""Largest angle of a ray from the boresight. Numerics: its tangent is finite."""
MIN_PATCH = 3
"""Least number of rows and columns in which edges are searched. Numerics: the smoothing and the search need
neighbours."""
LIT_SHARE = 0.25
"""Least amplitude of pixels from which the noise is estimated, over the median amplitude. Hand: as
``amplitude_noise.LIT``."""
CHANGE_SIGMAS = 3.0
"""Least change of amplitude that counts as an edge, over its noise. Physics: one in 370 normal errors is
larger."""
MOST_SATURATED = 0.8
"""Largest share of saturated pixels among the lit ones. Hand: with more, the edges are borders of the
saturated area and not of the target."""
MIXED_BLURS = 2.0
"""Distance from a saturated pixel, over the blur, within which edges are shifted. Physics: it contains 95 %
of a normal blur."""
_NO_PATCH = Patch(np.zeros((1, 1), np.float32), np.zeros((1, 1), np.float32), 0.0, 0.0, 1.0, 0.0, 0.0)
"""Patch of a frame without amplitude, in which no edge is found."""
_Window = tuple[slice, slice]
"""A window of the image: rows and columns."""


@dataclass(frozen=True, eq=False)
class JointFrame:
    """One frame, prepared for the kernels."""

    view: DepthView
    range_m: FloatArray
    """Range of the coarse pixels, shape (rows, columns); NaN if a pixel has none."""
    every_range_m: FloatArray
    """The same with the ranges whose noise is above ``most_noise_m``."""
    sigma_m: FloatArray
    """Standard deviation of the ranges' noise, same shape."""
    shade: FloatArray
    """Amplitude of the coarse pixels, same shape; 0 where a glint saturates, NaN if unknown."""
    typical: float
    """Median amplitude of the pixels with depth, or that of the patch if they are too few; 0 if unknown."""
    points_m: FloatArray
    """Points of the depth image, sensor axes, shape (N, 3)."""
    pixel: NDArray[np.intp]
    """Row-major index of each point's coarse pixel, shape (N,)."""
    away_m: float
    """Median z of the points within the target's bounding sphere, m; z of its origin if there are none."""
    noise_m: float
    """Median standard deviation of the points' noise; 0 without points."""
    white_m2: float
    """Variance of the points' weighted mean caused by this noise, times the sum of their weights."""
    spread_m2: float
    """Weighted mean of the variances of this noise."""
    trust: FloatArray
    """Weight of each point, 0 to 1, shape (N,); it is smaller for dark points, which are noisy."""
    patch: Patch
    """Smoothed amplitude around the target."""
    rays: GridArrays
    """Rays of the patch's pixels, shape (per_px * rows, per_px * columns)."""
    per_px: int
    """Number of these rays for each pixel, along rows and columns."""
    frequencies_hz: FloatArray
    """Modulation frequencies, shape (F,), Hz; shape (0,) if the camera does not state them."""

    @classmethod
    def of(cls, frame: PmdFrame, t: FloatArray, *, radius_m: float, tuning: JointTuning) -> Self | str:
        """Return a frame for a target expected at ``t``, shape (3,), m, or why it cannot be used."""
        if frame.camera.distortion[LENS_COEFFICIENTS:].any():
            return f"distortion has {len(frame.camera.distortion)} coefficients, limit {LENS_COEFFICIENTS}"
        try:
            around = _around(frame.camera, t, radius_m)
            if (share := _saturated_share(frame, around)) > MOST_SATURATED:
                limit = f"at most {MOST_SATURATED:.0%} may be; reduce the exposure time"
                return f"{share:.0%} of the lit pixels are saturated, {limit}"
            return cls._prepared(frame, t, around, radius_m=radius_m, tuning=tuning)
        except DistortionError as error:
            return str(error)

    @classmethod
    def _prepared(
        cls, frame: PmdFrame, t: FloatArray, around: _Window, *, radius_m: float, tuning: JointTuning
    ) -> Self:
        """Return the frame, prepared for the edges in a window.

        Raises:
            DistortionError: the lens distortion cannot be inverted at a pixel that is used.
        """
        radius_px = frame.camera.fx * radius_m / max(t[2], 1e-3)
        stride = _stride(frame, around, radius_px=radius_px, points=tuning.depth.points)
        view = DepthView.of(frame.camera, stride)
        amplitude = _even(frame.depth_m.shape) if frame.amplitude is None else frame.amplitude
        least, pixels = stray_light(frame, tuning.ghost_share), CoarsePixels(view.stride, view.offset)
        steepest = SLANTED / frame.camera.fx
        images = DepthImages(frame.depth_m, amplitude, least)
        rays_z = view.coarse.components[2]
        range_m, sigma_m, strengths, shade = coarse_ranges(images, rays_z, pixels, steepest)
        every_range_m = range_m.copy()
        range_m[sigma_m > tuning.check.most_noise_m] = np.nan
        measured = _measured(range_m, tuning.depth.points)
        rays = view.coarse.components.reshape(3, -1)[:, measured]
        points_m = np.ascontiguousarray((rays * range_m.ravel()[measured]).T)
        strength = strengths.ravel()[measured]
        typical = float(np.median(strength)) if len(measured) else 0.0
        noise = sigma_m.ravel()[measured]
        noise_m = float(np.median(noise)) if len(measured) else 0.0
        trust = _trust(noise, strength, tuning.depth.noise_m)
        whole = max(float(trust.sum()), 1e-12)
        patch = _NO_PATCH
        if frame.amplitude is not None:
            patch = _patch(frame, frame.amplitude, around, typical=typical, config=tuning.edges)
        if len(measured) < tuning.acceptance.min_points:
            typical = patch.typical
        shade[_unknown_shade(frame, view)] = np.nan
        per_px = FINE_RAYS if patch.image.size <= FINE_PX else 1
        return cls(
            view,
            range_m,
            every_range_m,
            sigma_m,
            shade,
            typical,
            points_m,
            measured,
            _away_m(points_m, t, radius_m),
            noise_m,
            float((trust * noise) @ (trust * noise)) / whole,
            float(trust @ noise**2) / whole,
            trust,
            patch,
            _rays_of(patch, view, per_px),
            per_px,
            _frequencies_hz(frame),
        )

    def finely(self) -> Self:
        """Return the frame with ``FINE_RAYS`` rays along rows and columns of each pixel of the patch."""
        return replace(self, rays=_rays_of(self.patch, self.view, FINE_RAYS), per_px=FINE_RAYS)

    def radius_px(self, radius_m: float) -> float:
        """Return a target's radius in the image, px, at the median depth of its visible points."""
        return float(self.view.camera.fx * radius_m / self.away_m)

    def px_per_m_along(self, t: FloatArray, radius_m: float) -> float:
        """Return the motion of a target's outline, px, per metre of its motion along the line of sight."""
        away_m, range_m = max(float(t[2]), self.away_m), max(math.hypot(*t), NEAREST_M)
        return float(self.view.camera.fx * radius_m / away_m / range_m)

    def fills(self, radius_m: float) -> float:
        """Return a target's radius over the image's smaller side; above 1 few of its parts are in view."""
        return self.radius_px(radius_m) / min(self.view.camera.width, self.view.camera.height)

    @cached_property
    def lens(self) -> Lens:
        """The camera, as the kernels take it."""
        camera = self.view.camera
        return Lens(camera.fx, camera.fy, camera.cx, camera.cy, *camera.coefficients.tolist())

    def moved_px(self, before: PoseArrays, pose: PoseArrays, radius_m: float) -> float:
        """Return the largest motion of a target's points in this image between two poses, px."""
        return moved_px(before, pose, radius_m, self.view.camera.fx / max(pose.t[2], self.away_m))

    @property
    def pixels(self) -> CoarsePixels:
        """Positions of the coarse pixels."""
        return CoarsePixels(self.view.stride, self.view.offset)


def _even(shape: tuple[int, ...]) -> NDArray[np.uint16]:
    """Return an amplitude image of ones, for a frame without an amplitude image.

    It has the type of an image from the bus, for which the kernels are compiled before the first frame.
    Compiling them for another type would stop tracking for a second or more.
    """
    ones = np.ones(shape, np.uint16)
    ones.setflags(write=False)
    return ones


def _saturated_share(frame: PmdFrame, around: _Window) -> float:
    """Return the share of saturated pixels among those that are saturated or have depth."""
    if frame.saturated is None:
        return 0.0
    saturated = int(np.count_nonzero(frame.saturated[around]))
    return saturated / max(1, saturated + int(np.count_nonzero(frame.depth_m[around] > 0.0)))


def _trust(sigma_m: FloatArray, strength: FloatArray, other_m: float) -> FloatArray:
    """Return the weights of points: the variance of a range without noise over its variance with noise.

    The noise is taken as inversely proportional to the amplitude, since the few pixels of a point estimate it
    too poorly.

    Args:
        sigma_m: standard deviation of the points' noise, as estimated from their pixels, shape (N,).
        strength: amplitude of the points, shape (N,).
        other_m: standard deviation of the other errors of a range.
    """
    scale_m = float(np.median(sigma_m * strength)) if len(strength) else 0.0
    return 1.0 / (1.0 + (scale_m / (other_m * np.maximum(strength, 1e-9))) ** 2)


def _measured(range_m: FloatArray, points: int) -> NDArray[np.intp]:
    """Return the row-major indices of pixels with a range, at most ``points``, evenly spread."""
    measured = np.flatnonzero(np.isfinite(range_m))
    if len(measured) > points:
        measured = measured[np.linspace(0, len(measured) - 1, points).astype(np.intp)]
    return measured


def _unknown_shade(frame: PmdFrame, view: DepthView) -> NDArray[np.bool_]:
    """Return the coarse pixels with unknown amplitude: the saturated ones, or all without an image."""
    shape = view.coarse.components.shape[1:]
    if frame.amplitude is None:
        return np.ones(shape, np.bool_)
    if frame.saturated is None:
        return np.zeros(shape, np.bool_)
    coarse = slice(view.offset, None, view.stride)
    return _widened(frame.saturated, 1)[coarse, coarse]


@kernel
def moved_px(before: PoseArrays, pose: PoseArrays, radius_m: float, px_per_m: float) -> float:
    """Return the largest motion in the image, px, of a target's points between two poses.

    Args:
        before: one pose.
        pose: the other pose.
        radius_m: radius of the target.
        px_per_m: motion in the image per metre across the line of sight.
    """
    turned = np.sqrt(np.square(pose.R - before.R).sum() / 2.0)  # 2 sin(angle / 2)
    shifted_m = np.sqrt(np.square(pose.t - before.t).sum())
    return float(px_per_m * (shifted_m + turned * radius_m))


def _rays_of(patch: Patch, view: DepthView, per_px: int) -> GridArrays:
    """Return the rays of a patch's pixels, ``per_px`` of each along rows and columns."""
    starts = zip((int(patch.row), int(patch.column)), patch.image.shape, strict=True)
    return view.rays(per_px).block(*(slice(per_px * i, per_px * (i + size)) for i, size in starts))


def _away_m(points_m: FloatArray, t: FloatArray, radius_m: float) -> float:
    """Return the median depth of a target's visible points, m.

    The origin of a close target does not suit: it may lie beside or behind the camera.
    """
    own = np.square(points_m - t).sum(axis=1) < radius_m**2
    z_m = np.median(points_m[own, 2]) if own.any() else t[2]
    return max(float(z_m), NEAREST_M)


def _stride(frame: PmdFrame, around: _Window, *, radius_px: float, points: int) -> int:
    """Return the stride at which the depth on the target gives the wanted number of points."""
    camera = frame.camera
    filled = FILLED * min(camera.width, 2.0 * radius_px) * min(camera.height, 2.0 * radius_px)
    left = SPARSE**2 * int(np.count_nonzero(frame.depth_m[around][::SPARSE, ::SPARSE] > 0.0))
    return int(np.clip(np.sqrt(min(filled, left) / points), *STRIDES_PX))


def _around(camera: Camera, t: FloatArray, radius_m: float) -> _Window:
    """Return the rows and columns around the target's bounding sphere; all if the target is close."""
    if t[2] <= 2.0 * radius_m:
        return slice(0, camera.height), slice(0, camera.width)
    # The limits of the sphere along each axis of the image, at least those of a sphere on the boresight.
    angle_rad = np.arctan2(t[:2], t[2])
    half_rad = np.arcsin(radius_m / np.hypot(t[:2], t[2]))
    middle, radius = t[:2] / t[2], radius_m / (t[2] - radius_m)
    lower = np.minimum(np.tan(np.maximum(angle_rad - half_rad, -_STEEPEST_RAD)), middle - radius)
    upper = np.maximum(np.tan(np.minimum(angle_rad + half_rad, _STEEPEST_RAD)), middle + radius)
    if camera.coefficients.any():
        return _around_in_lens(camera, lower, upper)
    focal, centre = np.array((camera.fx, camera.fy)), np.array((camera.cx, camera.cy))
    first, last = focal * lower + centre - MARGIN_PX, focal * upper + centre + MARGIN_PX
    return _between(first[1], last[1], camera.height), _between(first[0], last[0], camera.width)


def _around_in_lens(camera: Camera, lower: FloatArray, upper: FloatArray) -> _Window:
    """Return the window of the pixels whose slopes x/z and y/z lie within limits, each of shape (2,).

    Raises:
        DistortionError: the lens distortion cannot be inverted.
    """
    view = DepthView.of(camera, STRIDES_PX[-1])
    slopes = view.slopes[view.offset :: view.stride, view.offset :: view.stride]
    near: NDArray[np.bool_] = np.all((lower <= slopes) & (slopes <= upper), axis=-1)
    lines = (view.offset + view.stride * np.flatnonzero(near.any(axis=axis)) for axis in (1, 0))
    margin, sizes = MARGIN_PX + view.stride, (camera.height, camera.width)
    rows, columns = (
        _between(line[0] - margin, line[-1] + margin, size) if line.size else slice(0, 0)
        for line, size in zip(lines, sizes, strict=True)
    )
    return rows, columns


def _between(first: float, last: float, size: int) -> slice:
    """Return the rows or columns from ``first`` to ``last`` within an image; all of them if one is NaN."""
    if np.isnan(first) or np.isnan(last):
        return slice(0, size)
    return slice(int(np.clip(first, 0.0, size)), int(np.clip(last, 0.0, size)))


def _patch(
    frame: PmdFrame,
    amplitude: NDArray[np.generic],
    around: _Window,
    *,
    typical: float,
    config: JointEdgeConfig,
) -> Patch:
    """Return the smoothed amplitude around the target, with its noise and the least change that counts.

    The typical amplitude of pixels with depth is only a first value: perhaps only dark parts have depth.
    """
    rows, columns = around
    part = np.nan_to_num(amplitude[around].astype(np.float32))
    if min(part.shape) < MIN_PATCH:
        return _NO_PATCH
    saturated = None if frame.saturated is None else frame.saturated[around]
    typical = typical_of(part, typical, frame.depth_m[around])
    if typical <= 0.0:
        return _NO_PATCH
    known = part if saturated is None else np.where(saturated, np.float32(0.0), part)
    noise = noise_of_change(config.blur_px) * noise_of(known, LIT_SHARE * typical)
    most = np.float32(config.clip * typical)
    unclipped = _smoothed(part, config.blur_px)
    smooth = _smoothed(np.minimum(part, most), config.blur_px) if part.max() > most else unclipped
    least = max(config.least_contrast * typical, CHANGE_SIGMAS * noise)
    mixed = NOT_SATURATED
    if saturated is not None:
        mixed = _widened(saturated, math.ceil(MIXED_BLURS * config.blur_px)).view(np.uint8)
    unranged = (~(frame.depth_m[around] > 0.0)).view(np.uint8)
    rad_per_m = 4.0 * np.pi / speed_of_light * _frequencies_hz(frame)
    at = float(columns.start), float(rows.start)
    return Patch(smooth, unclipped, *at, least, noise, typical, mixed, unranged, rad_per_m)


def _smoothed(image: Float32Array, blur_px: float) -> Float32Array:
    """Return an image smoothed with a Gaussian kernel of a standard deviation, px."""
    smooth: Float32Array = cv2.GaussianBlur(image, (0, 0), blur_px)  # type: ignore[assignment]
    return smooth


def _frequencies_hz(frame: PmdFrame) -> FloatArray:
    """Return the modulation frequencies, shape (F,), Hz; shape (0,) if the camera does not state them."""
    return np.empty(0) if frame.info is None else frame.info.modulation_frequency_hz


def _widened(mask: NDArray[np.bool_], by_px: int) -> NDArray[np.bool_]:
    """Return a mask, same shape, of the pixels at most ``by_px`` rows and columns from one of a mask."""
    side = 2 * by_px + 1
    return cv2.dilate(mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0
