"""The centre of a circular face in the image: a Hough circle on the face's own plane.

Klionovska et al., Robotics 7(1), 2018, section 3.3.1. The Hough transform finds circles only, and a circle
seen obliquely is an ellipse whose centre is not the circle's. Therefore the image is resampled on the
predicted plane of the face, where the circle is round and its centre is the face's.
"""

from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_geometry.kernels import kernel
from rpod_pose.pmd.paper_2018.edge_image import EdgeImage, bent
from rpod_pose.pmd.paper_2018.wireframe_view import plane_axes
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.amplitude import CircleConfig
from rpod_schemas.types import Float32Array
from rpod_target.outlines import Disc

MARGIN = 1.4
"""Extent of the resampled image from the predicted centre, in radii, beyond the reach of the search. Hand:
the rim and 40 % more."""
SPOKES = 48
"""Number of directions from the centre along which the rim is looked for. Numerics: a budget, 7.5 deg
apart."""
STEPS = 25
"""Number of points along a spoke at which the amplitude is read. Numerics: a budget of computation."""
REFITS = 3
"""Number of times that the circle is fitted, each time in a narrower search. Numerics: a budget."""
LEAST_STEP = 0.01
"""Least change between two points of a spoke that counts as an edge, as a share of white. Hand: 2.5 of 255
grey values, a little above their rounding."""
_ANGLE = np.arange(SPOKES) * (2.0 * np.pi / SPOKES)
"""Angles of the spokes, rad. Physics: even over the circle."""
_SPOKE = np.stack((np.cos(_ANGLE), np.sin(_ANGLE)), axis=1)
"""Directions of the spokes, shape (SPOKES, 2)."""


@dataclass(frozen=True, eq=False)
class DiscPlane:
    """The plane of a disc in an image; its coordinates are in radii from the disc's centre."""

    image: EdgeImage
    homography: FloatArray
    """Homography from homogeneous points of the plane to undistorted pixels, shape (3, 3)."""
    cosine: float
    """Cosine of the angle between the line of sight and the disc's axis."""

    @classmethod
    def of(cls, image: EdgeImage, disc: Disc, T_sensor_target: RigidTransform) -> Self:
        """Return the plane of a disc at a pose."""
        R = T_sensor_target.rotation.as_matrix()
        centre_m = R @ disc.centre_m + T_sensor_target.translation
        first, second = disc.radius_m * plane_axes(disc.normal) @ R.T
        homography = image.camera.K @ np.stack((first, second, centre_m), axis=1)
        cosine = -float(R @ disc.normal @ centre_m) / float(np.linalg.norm(centre_m))
        return cls(image, homography, cosine)

    def straight_pixels(self, places: FloatArray) -> FloatArray:
        """Return the undistorted pixels of points of the plane, shape (..., 2)."""
        seen = places @ self.homography[:, :2].T + self.homography[:, 2]
        pixels: FloatArray = seen[..., :2] / seen[..., 2:]
        return pixels

    def read(self, values: Float32Array | NDArray[np.uint8], places: FloatArray) -> FloatArray:
        """Return an image's values at points of the plane, shape (rows, columns, 2); 0 outside the image."""
        pixels = self.straight_pixels(places)
        camera = self.image.camera
        if camera.distortion.any():
            pixels = bent(pixels.reshape(-1, 2), camera).reshape(places.shape)
        column, row = np.moveaxis(pixels.astype(np.float32), -1, 0)
        read = cv2.remap(values, column, row, cv2.INTER_LINEAR, borderValue=0.0)
        return np.asarray(read, np.float64)

    @property
    def radius_px(self) -> float:
        """Longest radius of the disc in the image."""
        rim = self.straight_pixels(_SPOKE) - self.straight_pixels(np.zeros(2))
        return float(np.sqrt((rim**2).sum(axis=1).max()))


def circle_centre(
    plane: DiscPlane, *, reach: float, tolerance: float, config: CircleConfig, canny_high: float | None
) -> FloatArray | None:
    """Return the undistorted pixel of a disc's centre, shape (2,), or None if no circle is found.

    Args:
        plane: plane of the disc at the predicted pose.
        reach: largest distance of the centre from the predicted one, in radii.
        tolerance: largest difference of the radius from the predicted one, as a share of it.
        config: all other thresholds.
        canny_high: gradient from which a pixel starts an edge, grey levels; None to measure the circle around
            the predicted centre without a Hough transform.
    """
    if plane.cosine < config.min_cosine or plane.radius_px < config.min_radius_px:
        return None
    centre: FloatArray | None = np.zeros(2)
    if canny_high is not None:
        centre = hough_circle(plane, (reach, tolerance), config=config, canny_high=canny_high)
    if centre is not None:
        centre = measured_circle(plane, centre, tolerance=tolerance, min_rim_share=config.min_rim_share)
    if centre is None or np.linalg.norm(centre) > reach:
        return None
    return plane.straight_pixels(centre)


def hough_circle(
    plane: DiscPlane, limits: tuple[float, float], *, config: CircleConfig, canny_high: float
) -> FloatArray | None:
    """Return the centre of the Hough circle nearest to the predicted one, in radii from it, shape (2,).

    The limits are the largest distance from it, in radii, and the largest difference of the radius, as a
    share.
    """
    reach, tolerance = limits
    radius_px = min(config.radius_px, plane.radius_px)
    half = int(np.ceil((MARGIN + reach) * radius_px))
    across = np.arange(-half, half + 1) / radius_px
    drawing = plane.read(plane.image.grey, np.stack(np.meshgrid(across, across), axis=-1))
    circles = cv2.HoughCircles(
        drawing.astype(np.uint8),
        cv2.HOUGH_GRADIENT,
        dp=1.0,
        minDist=max(1.0, 0.25 * radius_px),
        param1=canny_high,
        param2=config.votes,
        minRadius=int((1.0 - tolerance) * radius_px),
        maxRadius=int(np.ceil((1.0 + tolerance) * radius_px)),
    )
    if circles is None:
        return None
    centres = (circles.reshape(-1, circles.shape[-1])[:, :2].astype(np.float64) - half) / radius_px
    nearest: FloatArray = centres[np.argmin(np.linalg.norm(centres, axis=1))]
    return nearest


def measured_circle(
    plane: DiscPlane, centre: FloatArray, *, tolerance: float, min_rim_share: float
) -> FloatArray | None:
    """Return the centre, to sub-pixel, of a circle fitted to the rim, in radii from the predicted one.

    The rim is the steepest point of the linear amplitude along spokes from the centre.
    """
    radius, spread = 1.0, tolerance
    for _ in range(REFITS):
        distance = radius + np.linspace(-spread, spread, STEPS)
        read = plane.read(plane.image.light, centre + distance[:, None] * _SPOKE[:, None])
        slope = np.abs(np.diff(read, axis=1))
        steepest = slope.argmax(axis=1)
        clear = slope.max(axis=1) > LEAST_STEP
        rim = centre + ((distance[:-1] + distance[1:]) / 2.0)[steepest, None] * _SPOKE
        if clear.mean() < min_rim_share:
            return None
        centre, radius = circle_through(rim[clear])
        if abs(radius - 1.0) > tolerance or np.linalg.norm(centre) > 10.0:
            return None
        spread = max(0.5 * spread, 0.06)
    return centre


@kernel
def circle_through(points: FloatArray) -> tuple[FloatArray, float]:
    """Return centre, (2,), and radius of the circle fitted to points, (N, 2): least squares (Kasa, 1976).

    The fit is repeated without the points whose residual is above twice the median.
    """
    centre, radius = np.zeros(2), 1.0
    off, limit = np.zeros(points.shape[0]), 1.0
    for _ in range(2):
        sums, right, row = 1e-12 * np.eye(3), np.zeros(3), np.ones(3)
        for n in range(points.shape[0]):
            if off[n] <= limit:
                row[0], row[1] = 2.0 * points[n, 0], 2.0 * points[n, 1]
                sums += np.outer(row, row)
                right += row * (points[n] ** 2).sum()
        x, y, rest = np.linalg.solve(sums, right)
        centre[0], centre[1] = x, y
        radius = np.sqrt(max(rest + x * x + y * y, 0.0))
        for n in range(points.shape[0]):
            off[n] = abs(np.sqrt(((points[n] - centre) ** 2).sum()) - radius)
        limit = 2.0 * np.median(off) + 1e-9
    return centre, radius
