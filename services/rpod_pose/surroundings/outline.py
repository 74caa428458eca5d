"""Share of the target's outline that a frame shows: where the measured surface ends with the target.

Separation at a pose makes everything beside the rendered target dark. On a plane that continues there, such
as a wall or a plate, the outline of any pose then seems to be in its place. The outline is evidence only
where the measured surface ends. It is unknown outside the field of view and behind other things.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.rays import Hits, RayGrid, cast
from rpod_pose.surroundings.separation import BESIDE, NEIGHBOURS, RangeImage
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Camera
from rpod_target import Target

_SIDE = 64
"""Number of rows and columns of the image that shows the whole outline. Numerics: a budget; a share of the
outline is then known to about 1 %."""
_SMOOTH = 2.0
"""Standard deviation, rays, of the smoothing that gives the outline's direction. Numerics: the steps of a
rasterised line are one ray wide."""


def seen_outline(
    image: RangeImage, target: Target, T_sensor_target: RigidTransform, margin_m: float
) -> float:
    """Return the share of the target's whole outline at which the measured surface ends.

    Args:
        image: ranges of a frame.
        target: the target.
        T_sensor_target: its pose.
        margin_m: least difference of ranges between separate surfaces.
    """
    hits = cast(image.grid, target.triangles_m, T_sensor_target, cull_back_faces=target.field is not None)
    met = hits.triangle >= 0
    rim = met & ~cv2.erode(met.view(np.uint8), NEIGHBOURS, borderValue=1).view(np.bool_)
    row, column = np.nonzero(rim)
    if not len(row):
        return 0.0
    distance_m = float(np.linalg.norm(T_sensor_target.translation))
    beside = np.array(image.rays_across(BESIDE * target.radius_m, distance_m).longer(1))[:, None]
    outwards = _outwards(met, row, column)
    at = np.rint(np.stack((row, column)) + beside * outwards).astype(np.intp)
    rows, columns = image.range_m.shape
    within = (at >= 0).all(axis=0) & (at[0] < rows) & (at[1] < columns)
    measured_m = image.range_m[at[0, within], at[1, within]]
    surface_m = hits.range_m[row[within], column[within]]
    # a ray without a range has met nothing within reach
    ends = ~(measured_m > 0.0) | (measured_m > surface_m + margin_m)
    return float(np.count_nonzero(ends)) / len(row) * _outline_in_view(image, target, T_sensor_target)


def _outwards(met: NDArray[np.bool_], row: NDArray[np.intp], column: NDArray[np.intp]) -> FloatArray:
    """Return the direction out of the target at rays of its outline, rows and columns, shape (2, N)."""
    smooth = cv2.GaussianBlur(met.astype(np.float32), (0, 0), _SMOOTH, borderType=cv2.BORDER_REPLICATE)
    down, across = (cv2.Sobel(smooth, cv2.CV_32F, *order) for order in ((0, 1), (1, 0)))
    slope = -np.stack((down[row, column], across[row, column])).astype(np.float64)
    unit: FloatArray = slope / np.maximum(np.linalg.norm(slope, axis=0), 1e-12)
    return unit


def _outline_in_view(image: RangeImage, target: Target, T_sensor_target: RigidTransform) -> float:
    """Return the share of the whole outline that lies in the field of view."""
    distance_m = float(np.linalg.norm(T_sensor_target.translation))
    away_m = max(distance_m, 1.01 * target.radius_m)
    focal = 0.5 * _SIDE * np.sqrt(away_m**2 - target.radius_m**2) / target.radius_m
    middle = 0.5 * (_SIDE - 1)
    lens = Camera(width=_SIDE, height=_SIDE, fx=focal, fy=focal, cx=middle, cy=middle)
    grid = RayGrid.pinhole(lens)
    towards, _ = Rotation.align_vectors(T_sensor_target.translation[None], [[0.0, 0.0, 1.0]])
    turned = RigidTransform.from_rotation(towards)
    hits: Hits = cast(grid, target.triangles_m, turned.inv() * T_sensor_target)
    met = hits.triangle >= 0
    rim = met & ~cv2.erode(met.view(np.uint8), NEIGHBOURS, borderValue=0).view(np.bool_)
    points_m = hits.range_m[rim][:, None] * grid.directions[rim]
    return image.in_view(turned.apply(points_m)) if len(points_m) else 0.0
