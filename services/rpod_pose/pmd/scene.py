"""One PMD frame on its coarse pixels: depth, amplitude, and pixels that are lit but have no depth.

Depth is missing where the target is dark, glints or is seen at a grazing angle. The amplitude is still
measured there, and shows the outline against the black sky.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, uniform_filter

from rpod_geometry.errors import DistortionError
from rpod_pose.pmd.depth_view import DepthView, downsampled, noise_of_medians, stray_light
from rpod_pose.search.energy import CELLS, Image
from rpod_pose.surroundings.places import SLANTED
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.search import PmdSceneConfig
from rpod_schemas.types import LENS_COEFFICIENTS, Camera, Float32Array, PmdFrame

DARKEST_PERCENT = 2.0
"""Percentile of the amplitudes of pixels with depth that stands for the darkest of them. Hand: a lower
percentile is noise, a higher one leaves dark materials out."""
SEGMENTATION_ROUNDS = 5
"""Largest number of iterations in which a ball around the target moves to the median of the points in it.
Numerics: a budget of computation."""
REACH = 1.5
"""Radius of a ball around the median of the target's visible points that contains all of them, over the
target's radius. Hand: about ``separation.BALL``."""
SKY_SPREADS, LEAST_AMPLITUDE = 9.0, 1.0
"""Least amplitude of a lit pixel: in median absolute deviations above the sky, and in counts. Physics: six
standard deviations of normal noise; a digital amplitude has no step below one count."""
MOST_GLINTS = 0.9
"""Largest share of the dark pixels that may be zero because of glints. Hand: with more zeros, they are a sky
whose amplitude has no noise."""
WIPED, TOUCHED = np.ones((3, 3), np.uint8), np.ones((5, 5), np.uint8)
"""Smallest shape of a glint, and the shape within which a glint changes medians. Physics: a median of 3 x 3
pixels removes smaller glints, and reaches as far."""


@dataclass(frozen=True, eq=False)
class ImagePoints:
    """Points of an image: ``energy.Returns``."""

    points_m: FloatArray
    """Positions, sensor axes, shape (N, 3)."""

    def downsampled(self, count: int) -> FloatArray:
        """Return at most ``count`` points, spread evenly over the image, shape (n, 3)."""
        chosen = np.linspace(0, len(self.points_m) - 1, min(count, len(self.points_m))).astype(np.intp)
        return self.points_m[chosen]


@dataclass(frozen=True, eq=False)
class PmdScene:
    """A frame's coarse pixels, created by ``scene_of``; arrays of pixels have the shape (rows, columns)."""

    view: DepthView
    range_m: Float32Array
    """Range along the ray; 0 on pixels without depth."""
    sigma_m: Float32Array
    """Standard deviation of a range's noise, estimated from the neighbours."""
    amplitude: Float32Array
    """Median amplitude of each pixel and its neighbours; 0 if unknown, or if a glint touches the pixel."""
    lit: NDArray[np.bool_]
    """Whether depth or amplitude show a surface on a pixel."""
    blind: NDArray[np.bool_]
    """Whether a glint saturated depth and amplitude of a pixel, which may show a surface or not."""
    points_m: FloatArray
    """The measured points of the target, sensor axes, shape (N, 3)."""
    hidden: NDArray[np.bool_]
    """Whether another thing may hide the target on a pixel."""
    least_amplitude: float
    """Least amplitude of a lit pixel; infinite without an amplitude image."""

    @property
    def outlined(self) -> bool:
        """Whether an amplitude image shows surfaces without depth."""
        return bool(np.isfinite(self.least_amplitude))

    def downsampled(self, count: int) -> FloatArray:
        """Return at most ``count`` measured points, spread evenly over the image, shape (n, 3)."""
        return ImagePoints(self.points_m).downsampled(count)

    @cached_property
    def surface(self) -> ImagePoints:
        """Points of all lit pixels; a pixel without depth takes the range of the nearest pixel with depth.

        Hidden pixels are left out: a thing that hides the target may extend far beyond it and would move the
        centroid.
        """
        nearest = distance_transform_edt(self.range_m == 0.0, return_distances=False, return_indices=True)
        shown = self.lit | (self.blind & ~self.hidden)
        points_m = (self.view.coarse.components * self.range_m[*nearest])[:, shown].T
        return ImagePoints(np.ascontiguousarray(points_m))

    def distances(self) -> Image:
        """Return the ``energy.Image`` of the squared angles to the nearest lit pixel."""
        view = self.view
        rad_per_px = view.stride / view.camera.fx, view.stride / view.camera.fy
        distance_rad = distance_transform_edt(~(self.lit | self.blind), sampling=rad_per_px[::-1])
        pixel, low, step = _cells(view)
        squares = (distance_rad**2).astype(np.float32).ravel()[pixel]
        return Image(squares, low[0], step[0], low[1], step[1])


@lru_cache(maxsize=8)
def _cells(view: DepthView) -> tuple[NDArray[np.intp], tuple[float, float], tuple[float, float]]:
    """Return the coarse pixel of each cell of an ``energy.Image``, and the image's first edges and steps.

    The columns of the image have equal steps in x/z, its rows in y/hypot(x, z).
    """
    x, y, z = view.coarse.components
    u, v = x / z, y / np.hypot(x, z)
    low, high = (float(u.min()), float(v.min())), (float(u.max()), float(v.max()))
    step = ((high[0] - low[0]) / CELLS, (high[1] - low[1]) / CELLS)
    middle_v, middle_u = np.meshgrid(
        *(low[axis] + (np.arange(CELLS) + 0.5) * step[axis] for axis in (1, 0)), indexing="ij"
    )
    upwards = middle_v * np.hypot(middle_u, 1.0)
    rays = np.stack((middle_u, upwards, np.ones((CELLS, CELLS))), axis=-1).reshape(-1, 3).astype(np.float64)
    coarse = np.rint((view.project(rays) - view.offset) / view.stride).astype(np.intp)
    rows, columns = view.coarse.shape
    pixel = coarse[:, 1].clip(0, rows - 1) * columns + coarse[:, 0].clip(0, columns - 1)
    return pixel.reshape(CELLS, CELLS), low, step


def scene_of(frame: PmdFrame, config: PmdSceneConfig, *, radius_m: float) -> PmdScene | str:
    """Return the scene of a frame with a target of this radius, or the reason why it cannot be used."""
    implausible = _implausible_camera(frame.camera, config)
    if implausible:
        return implausible
    shown, dim = _measured(frame, config), np.inf
    if frame.amplitude is not None and shown.any():
        dim = _dim(frame.amplitude, shown, config.lit_share)
    bright = shown if frame.amplitude is None else shown | (frame.amplitude > dim)
    stride = int(np.clip(round(np.sqrt(np.count_nonzero(bright) / config.pixels)), 1, config.most_stride_px))
    try:
        found = _strided(frame, shown, dim, DepthView.of(frame.camera, stride), REACH * radius_m)
        while len(found.points_m) < config.min_points and stride > 1:
            stride -= 1  # a faint target has depth on few of the pixels that are bright
            found = _strided(frame, shown, dim, DepthView.of(frame.camera, stride), REACH * radius_m)
    except DistortionError as error:
        return str(error)
    if len(found.points_m) < config.min_points:
        return f"{len(found.points_m)} pixels with depth on the target, {config.min_points} needed"
    return found


def _dim(amplitude: NDArray[np.uint16], shown: NDArray[np.bool_], share: float) -> float:
    """Return the amplitude above which a pixel is lit unless noise explains it.

    It lies between the amplitude of the sky, which is not dark if amplitudes have a pedestal, and that of the
    darkest pixels with depth. If the sky is as bright as these pixels, its amplitude is not used.

    Args:
        amplitude: amplitude of all pixels, shape (H, W).
        shown: pixels whose depth is used, at least one, shape (H, W).
        share: share of the difference between the darkest pixels with depth and the sky.
    """
    darkest = float(np.percentile(amplitude[shown], DARKEST_PERCENT))
    sky = float(np.median(amplitude[~shown])) if not shown.all() else 0.0
    return sky + share * (darkest - sky) if sky < darkest else share * darkest


def _strided(
    frame: PmdFrame, shown: NDArray[np.bool_], dim: float, view: DepthView, reach_m: float
) -> PmdScene:
    """Return the scene on the pixels of a view.

    Args:
        frame: the frame.
        shown: pixels whose depth is used, shape (H, W).
        dim: amplitude above which a pixel is lit unless noise explains it; infinite if unknown.
        view: the coarse pixels.
        reach_m: distance along a ray within which a surface belongs to the target, m.
    """
    every = (slice(view.offset, None, view.stride),) * 2
    shown_m = np.where(shown, frame.depth_m, np.float32(np.nan))
    depth_m = downsampled(shown_m, view.stride, view.offset)
    rays = view.coarse.components
    range_m = np.nan_to_num(depth_m / rays[2], nan=0.0).astype(np.float32)
    nearby = _around(rays, range_m, reach_m)
    amplitude, lit, blind, least = _amplitudes(frame.amplitude, view, range_m == 0.0, dim)
    if frame.saturated is not None:  # lit, by an amplitude that is unknown
        saturated = frame.saturated[every]
        amplitude[saturated] = 0.0
        lit |= saturated & (range_m == 0.0)
    range_m = np.where(nearby, range_m, np.float32(0.0))
    points_m = np.ascontiguousarray((rays * range_m)[:, nearby].T)
    sigma_m = noise_of_medians(shown_m, view.stride, view.offset, depth_m.shape, SLANTED / frame.camera.fx)
    sigma_m /= rays[2].astype(np.float32)
    hidden = np.zeros(lit.shape, bool)
    if frame.hidden is not None:
        hidden = (cv2.dilate(frame.hidden.astype(np.uint8), TOUCHED) > 0)[every]
    return PmdScene(view, range_m, sigma_m, amplitude, lit | nearby, blind & ~nearby, points_m, hidden, least)


def _amplitudes(
    amplitude: NDArray[np.uint16] | None, view: DepthView, unmeasured: NDArray[np.bool_], dim: float
) -> tuple[Float32Array, NDArray[np.bool_], NDArray[np.bool_], float]:
    """Return the scene's amplitudes, the lit and the blind pixels without depth, and the least lit amplitude.

    Args:
        amplitude: amplitude of all pixels, shape (H, W).
        view: the coarse pixels.
        unmeasured: coarse pixels without depth, shape (rows, columns).
        dim: amplitude above which a pixel is lit unless noise explains it; infinite if unknown.
    """
    if amplitude is None or not np.isfinite(dim):
        none = np.zeros(unmeasured.shape, bool)
        return np.zeros(unmeasured.shape, np.float32), none, none, np.inf
    every = (slice(view.offset, None, view.stride),) * 2
    touched = _touched(amplitude, dim)[every]
    smooth = uniform_filter(amplitude.astype(np.float32), 3)
    least = least_lit(smooth[every][unmeasured & ~touched], dim)
    median = np.where(touched, 0, cv2.medianBlur(amplitude, 3)[every]).astype(np.float32)
    lit = unmeasured & (median > least)
    return median, lit, touched & ~lit, least


def _implausible_camera(camera: Camera, config: PmdSceneConfig) -> str:
    """Return why a camera matrix cannot belong to the image; empty if it can.

    A wrong principal point shears the depth image so little that the image itself does not show it.
    """
    if camera.distortion[LENS_COEFFICIENTS:].any():
        return f"distortion has {len(camera.distortion)} coefficients, limit {LENS_COEFFICIENTS}"
    off = max(abs((camera.cx + 0.5) / camera.width - 0.5), abs((camera.cy + 0.5) / camera.height - 0.5))
    if not off <= config.most_off_centre:
        return (
            f"the camera matrix is another image's: principal point ({camera.cx:.1f}, {camera.cy:.1f}) in an "
            f"image of {camera.width} x {camera.height}; check camera_info"
        )
    if not 1.0 <= max(camera.fx / camera.fy, camera.fy / camera.fx) <= config.most_oblong:
        return (
            f"the camera matrix is another image's: focal lengths {camera.fx:.1f} and {camera.fy:.1f} px; "
            "check camera_info"
        )
    return ""


def _measured(frame: PmdFrame, config: PmdSceneConfig) -> NDArray[np.bool_]:
    measured: NDArray[np.bool_] = np.isfinite(frame.depth_m) & (frame.depth_m > 0.0)
    if frame.amplitude is not None:
        measured &= frame.amplitude >= stray_light(frame, config.ghost_share)
    return measured


def least_lit(dark: Float32Array, most: float) -> float:
    """Return the least amplitude of a lit pixel, which is above the noise of the sky.

    Dark parts of the target among the pixels widen the distribution upwards. Therefore ``most`` limits the
    result, but not below the noise of the darker half of the pixels. If most pixels are brighter than
    ``most``, they do not show the sky.

    Args:
        dark: amplitudes of pixels without depth, most of which are sky, shape (N,).
        most: amplitude of a pixel that is lit unless noise explains it.
    """
    most = max(most, LEAST_AMPLITUDE)
    if not dark.size:
        return most
    middle = float(np.median(dark))
    if middle < most:
        most = max(most, middle + SKY_SPREADS * float(np.median(middle - dark[dark <= middle])))
    spread = float(np.median(np.abs(dark - middle)))
    return float(np.clip(middle + SKY_SPREADS * spread, LEAST_AMPLITUDE, most))


def _touched(amplitude: NDArray[np.uint16], dim: float) -> NDArray[np.bool_]:
    """Return which pixels are saturated by a glint or are beside one, shape (H, W).

    A glint saturates both taps of a pixel, so that their difference is exactly zero, on the surrounding
    pixels too. The amplitude of a sky with noise is never exactly zero on so many pixels.
    """
    wiped = (cv2.dilate(amplitude, WIPED) == 0).astype(np.uint8)
    if np.count_nonzero(wiped) > MOST_GLINTS * np.count_nonzero(amplitude <= dim):
        return np.zeros(amplitude.shape, bool)
    return cv2.dilate(wiped, TOUCHED) > 0


def _around(rays: FloatArray, range_m: Float32Array, radius_m: float) -> NDArray[np.bool_]:
    """Return which pixels measure a point within a radius of the points' median, computed iteratively."""
    measured = range_m > 0.0
    points_m = (rays * range_m)[:, measured].T
    near = np.ones(len(points_m), bool)
    for _ in range(SEGMENTATION_ROUNDS if len(points_m) else 0):
        near = np.linalg.norm(points_m - np.median(points_m[near], axis=0), axis=1) < radius_m
        if not near.any():
            break
    kept = np.zeros(range_m.shape, bool)
    kept[measured] = near
    return kept
