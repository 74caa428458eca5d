"""Edges and lines of the amplitude image: low-pass, Canny, sub-pixel positions, Hough lines.

Klionovska et al., Robotics 7(1), 2018, section 3.3.1, steps 1 to 5. Edges are found on grey levels of 8
bits, as in the paper, and then moved to the steepest point of the linear amplitude across them. The positions
that this module returns are undistorted: a lens without distortion would have imaged them there.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from rpod_geometry.errors import DistortionError
from rpod_geometry.lens import distort, undistort
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.amplitude import EdgeImageConfig
from rpod_schemas.types import LENS_COEFFICIENTS, Camera, Float32Array, PmdFrame

WHITE = 255.0
"""Largest grey value of an 8-bit image. Physics: 2^8 - 1."""
BRIGHTNESS_STRIDE = 2
"""Stride, across and down, of the pixels from which the image's brightness is estimated. Numerics: a budget
of computation."""
BEYOND_PX = 3.0
"""Distance from a silhouette, on its darker side, at which the background is read. Hand: past the blur of the
edge itself."""


@dataclass(frozen=True, eq=False)
class Edges:
    """Edge pixels and the lines that they form."""

    places: FloatArray
    """Column and row of the edge pixels, to sub-pixel, undistorted, shape (N, 2)."""
    across: FloatArray
    """Unit vectors across the edge towards its brighter side, shape (N, 2)."""
    segments: FloatArray
    """Ends of the Hough lines, undistorted, shape (M, 2, 2)."""


@dataclass(frozen=True, eq=False)
class EdgeImage:
    """Edges and lines of one amplitude image, made from a frame by ``edge_image``."""

    camera: Camera
    grey: NDArray[np.uint8]
    """Smoothed grey levels, shape (height, width)."""
    light: Float32Array
    """Smoothed amplitude, 1 for white, above 1 on glints, shape (height, width)."""
    inner: "Edges"
    """All edges."""
    outer: "Edges"
    """Edges whose darker side is background: silhouettes are among them, patterns of a surface are not."""

    def project(self, points_m: FloatArray) -> FloatArray:
        """Return the undistorted pixels of points in sensor axes with z > 0, shape (..., 2)."""
        camera = self.camera
        slopes = points_m[..., :2] / points_m[..., 2:]
        pixels: FloatArray = slopes * (camera.fx, camera.fy) + (camera.cx, camera.cy)
        return pixels

    def edges(self, *, silhouette: bool) -> "Edges":
        """Return the edges among which a line of the model is searched."""
        return self.outer if silhouette else self.inner


def edge_image(frame: PmdFrame, config: EdgeImageConfig) -> EdgeImage | str:
    """Return the edges and lines of a frame's amplitude, or the reason why there are none.

    Args:
        frame: frame with an amplitude of uint8, uint16 or float32, in any scale.
        config: all thresholds.
    """
    if frame.amplitude is None:
        return "no amplitude image was sent"
    if frame.camera.distortion[LENS_COEFFICIENTS:].any():
        return f"distortion has {len(frame.camera.distortion)} coefficients, limit {LENS_COEFFICIENTS}"
    light = _scaled(frame.amplitude, config)
    if isinstance(light, str):
        return light
    linear = _low_pass(np.minimum(light, 1.0), config.low_pass_px)
    grey = np.rint(WHITE * linear**config.gamma).astype(np.uint8)
    edges = np.asarray(cv2.Canny(grey, config.canny_low, config.canny_high, L2gradient=True), np.uint8)
    places, across = _steepest_places(edges, linear)
    beyond = _sampled(linear, places - BEYOND_PX * across)
    outer = (beyond < config.background_share) | (config.background_share == 0.0)
    try:
        inner_edges = _edges_of(edges, places, across, frame.camera, config)
        edges[tuple(np.transpose(np.nonzero(edges))[~outer].T)] = 0
        outer_edges = _edges_of(edges, places[outer], across[outer], frame.camera, config)
    except DistortionError as error:
        return str(error)
    if not len(inner_edges.segments):
        return "no straight line in the amplitude image"
    light = _low_pass(light, config.low_pass_px)
    return EdgeImage(frame.camera, grey, light, inner_edges, outer_edges)


def _edges_of(
    pixels: NDArray[np.uint8], places: FloatArray, across: FloatArray, camera: Camera, config: EdgeImageConfig
) -> Edges:
    """Return edges with their lines by the Hough transform: steps 3 to 5 of the paper.

    Raises:
        rpod_geometry.errors.DistortionError: the lens distortion cannot be inverted there.
    """
    found = cv2.HoughLinesP(
        pixels,
        config.hough_distance_px,
        np.deg2rad(config.hough_angle_deg),
        config.hough_votes,
        minLineLength=config.min_segment_px,
        maxLineGap=config.max_gap_px,
    )
    ends = np.empty((0, 2)) if found is None else np.asarray(found, np.float64).reshape(-1, 2)
    straight = straightened(np.concatenate((places, ends)), camera)
    return Edges(straight[: len(places)], across, straight[len(places) :].reshape(-1, 2, 2))


def _scaled(amplitude: NDArray[np.generic], config: EdgeImageConfig) -> Float32Array | str:
    """Return the amplitude as a share of white, or the reason why it shows nothing."""
    light = np.nan_to_num(amplitude.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    sparse = light[::BRIGHTNESS_STRIDE, ::BRIGHTNESS_STRIDE]
    brightest = float(np.percentile(sparse, 99.0))
    lit = sparse[sparse > config.dark_share * brightest]
    count = BRIGHTNESS_STRIDE**2 * lit.size if brightest > 0.0 else 0
    if count < config.min_lit:
        return f"{count} lit pixels in the amplitude image, {config.min_lit} needed"
    white = np.percentile(lit, config.white_percentile)
    return (np.maximum(light, 0.0) / white).astype(np.float32)


def _low_pass(light: Float32Array, sigma_px: float) -> Float32Array:
    return cv2.GaussianBlur(light, (0, 0), sigma_px).astype(np.float32, copy=False)


def _steepest_places(edges: NDArray[np.uint8], linear: Float32Array) -> tuple[FloatArray, FloatArray]:
    """Return the steepest point of the amplitude across each edge pixel, and the direction across it.

    It is the vertex of a parabola through the gradients at the pixel and its two neighbours across the edge.
    """
    row, column = np.nonzero(edges)
    right = cv2.Sobel(linear, cv2.CV_32F, 1, 0)
    down = cv2.Sobel(linear, cv2.CV_32F, 0, 1)
    steepness = np.hypot(right, down).astype(np.float32)
    gradient = np.stack((right[row, column], down[row, column]), axis=1).astype(np.float64)
    across = gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-12)
    pixels = np.stack((column, row), axis=1).astype(np.float64)
    before, here, after = (_sampled(steepness, pixels + side * across) for side in (-1.0, 0.0, 1.0))
    curvature = before - 2.0 * here + after
    peaked = curvature < -1e-9
    shift = np.where(peaked, 0.5 * (before - after) / np.where(peaked, curvature, 1.0), 0.0)
    return pixels + np.clip(shift, -1.0, 1.0)[:, None] * across, across


def _sampled(image: Float32Array, places: FloatArray) -> FloatArray:
    """Return an image interpolated at places, shape (N,); OpenCV's remap is limited to 32,766 places."""
    sampled: FloatArray = map_coordinates(image, places.T[::-1], np.float64, order=1, mode="nearest")
    return sampled


def straightened(pixels: FloatArray, camera: Camera) -> FloatArray:
    """Return undistorted pixels: where a lens without distortion images the same rays, shape (N, 2).

    Raises:
        rpod_geometry.errors.DistortionError: the lens distortion cannot be inverted there.
    """
    scale, centre = (camera.fx, camera.fy), (camera.cx, camera.cy)
    straight: FloatArray = undistort(((pixels - centre) / scale).T, camera).T * scale + centre
    return straight


def bent(pixels: FloatArray, camera: Camera) -> FloatArray:
    """Return distorted pixels: where the camera images the rays of undistorted pixels, shape (N, 2)."""
    scale, centre = (camera.fx, camera.fy), (camera.cx, camera.cy)
    seen: FloatArray = distort(((pixels - centre) / scale).T, camera).T * scale + centre
    return seen
