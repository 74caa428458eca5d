"""Lines of the image matched with the projected wireframe, and the corners where they intersect.

Klionovska et al., Robotics 7(1), 2018, section 3.3.1: each line of the model is projected with the prior pose
and matched with the Hough line nearest in angle and position, within thresholds. The paper pairs the ends of
the lines. Ends are shortened where an edge fades, so here each line is fitted to all edge pixels along it,
and neighbouring lines are intersected.
"""

from dataclasses import dataclass

import numpy as np

from rpod_geometry.kernels import kernel
from rpod_pose.pmd.paper_2018.edge_image import Edges
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.amplitude import LineMatchConfig

REFITS = 2
"""Number of times that a line is fitted again to the edge pixels near the last fit. Numerics: a budget."""
ALIGNED = np.cos(np.deg2rad(25.0))
"""Least cosine between an edge pixel's gradient and the normal of its line. Hand: 25 deg."""


@dataclass(frozen=True, eq=False)
class ImageLine:
    """A straight line in the image: all p with normal @ p = offset."""

    normal: FloatArray
    """Unit vector, shape (2,)."""
    offset_px: float


@dataclass(frozen=True)
class Reach:
    """Limits of the search around a feature's prediction."""

    angle_rad: float
    distance_px: float


def matched_line(
    edges: Edges, ends: FloatArray, *, reach: Reach, config: LineMatchConfig
) -> ImageLine | None:
    """Return the image's line matched with a line of the model with projected ends of shape (2, 2)."""
    segment = nearest_segment(edges.segments, ends, reach)
    return None if segment is None else measured_line(edges, segment, ends, reach=reach, config=config)


def nearest_segment(segments: FloatArray, ends: FloatArray, reach: Reach) -> FloatArray | None:
    """Return the ends of the segment nearest to a model line in angle and position; None if none is near.

    A segment counts if more than half of it lies along the model line, extended by the reach.
    """
    length_px = float(np.linalg.norm(ends[1] - ends[0]))
    if length_px < 1.0:
        return None
    along = (ends[1] - ends[0]) / length_px
    across = np.array((-along[1], along[0]))
    way = segments[:, 1] - segments[:, 0]
    angle_rad = np.abs(np.arctan2(way @ across, way @ along))
    angle_rad = np.minimum(angle_rad, np.pi - angle_rad)
    distance_px = np.abs((segments.mean(axis=1) - ends.mean(axis=0)) @ across)
    places = np.sort((segments - ends[0]) @ along, axis=1)
    inside = np.clip(places, -reach.distance_px, length_px + reach.distance_px)
    share = np.ptp(inside, axis=1) / np.maximum(np.ptp(places, axis=1), 1e-9)
    near = (angle_rad < reach.angle_rad) & (distance_px < reach.distance_px) & (share > 0.5)
    if not near.any():
        return None
    cost = angle_rad / reach.angle_rad + distance_px / reach.distance_px
    nearest: FloatArray = segments[np.argmin(np.where(near, cost, np.inf))]
    return nearest


def measured_line(
    edges: Edges, segment: FloatArray, ends: FloatArray, *, reach: Reach, config: LineMatchConfig
) -> ImageLine | None:
    """Return the line fitted to the edge pixels along a segment, between the ends of its model line."""
    limits = (config.band_px, reach.distance_px)
    middle, normal, members = line_along(edges.places, edges.across, segment, ends, limits)
    return ImageLine(normal, float(normal @ middle)) if members >= config.min_pixels else None


@kernel
def line_along(
    places: FloatArray, across: FloatArray, segment: FloatArray, ends: FloatArray, limits: tuple[float, float]
) -> tuple[FloatArray, FloatArray, int]:
    """Return a point and the normal of the line fitted to the edge pixels along a segment, and their number.

    The fit is by total least squares, and is repeated with the pixels near the fitted line.

    Args:
        places: positions of the edge pixels, shape (N, 2).
        across: unit vectors across the edge there, shape (N, 2).
        segment: ends of the initial line, shape (2, 2).
        ends: ends of the model line, which bound the pixels along the line, shape (2, 2).
        limits: largest distances from the line and beyond the ends, px.
    """
    band, beyond = limits
    x, y = (segment[0] + segment[1]) / 2.0
    dx, dy = segment[1] - segment[0]
    length = np.sqrt(dx * dx + dy * dy)
    dx, dy = dx / length, dy / length
    count = 0
    for _ in range(1 + REFITS):
        first = (ends[0, 0] - x) * dx + (ends[0, 1] - y) * dy
        last = (ends[1, 0] - x) * dx + (ends[1, 1] - y) * dy
        low, high = min(first, last) - beyond, max(first, last) + beyond
        count, su, sv, suu, suv, svv = 0, 0.0, 0.0, 0.0, 0.0, 0.0
        for n in range(places.shape[0]):
            u, v = places[n, 0] - x, places[n, 1] - y
            along = u * dx + v * dy
            steep = abs(across[n, 1] * dx - across[n, 0] * dy) > ALIGNED
            if abs(v * dx - u * dy) < band and low < along < high and steep:
                count += 1
                su, sv, suu, suv, svv = su + u, sv + v, suu + u * u, suv + u * v, svv + v * v
        if count < 2:
            return np.array((x, y)), np.array((-dy, dx)), 0
        x, y = x + su / count, y + sv / count
        suu, suv, svv = suu - su * su / count, suv - su * sv / count, svv - sv * sv / count
        angle = 0.5 * np.arctan2(2.0 * suv, suu - svv)  # direction of the scatter's larger axis
        dx, dy = np.cos(angle), np.sin(angle)
    return np.array((x, y)), np.array((-dy, dx)), count


def intersection(lines: list[ImageLine], *, min_turn_rad: float) -> FloatArray | None:
    """Return the point nearest to all lines, shape (2,); None if no two of them cross at a clear angle."""
    if len(lines) < 2:
        return None
    normals = np.stack([line.normal for line in lines])
    information = normals.T @ normals
    # Two lines at an angle a have the eigenvalues 1 +- |cos a|.
    if np.linalg.eigvalsh(information)[0] < 1.0 - np.cos(min_turn_rad):
        return None
    offsets_px = np.array([line.offset_px for line in lines])
    return np.asarray(np.linalg.solve(information, normals.T @ offsets_px), np.float64)
