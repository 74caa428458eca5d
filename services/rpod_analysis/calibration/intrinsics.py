"""Intrinsics of a camera from images of a checkerboard, by OpenCV."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from rpod_analysis.calibration.cameras import pmd_camera
from rpod_analysis.errors import CalibrationError
from rpod_analysis.log import Log
from rpod_analysis.log.sensors import pmd_frames
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Camera

_MOST_IMAGES = 60
"""Largest number of images in the fit, chosen so that they differ most; similar images add little."""
_LEAST_IMAGES = 6
_LEAST_MOVE_SHARE = 0.05
"""Least mean motion of the corners between two images, as a share of the image's width."""
_BRIGHTEST = 99.5
"""Percentile of the amplitude that is white: glints are brighter."""
_CELLS = 6
"""Cells each way into which the image is divided to tell how much of it the corners cover."""
_WELL_COVERED = 0.6
_WORST_RMS_PX = 1.0


@dataclass(frozen=True)
class Checkerboard:
    """A checkerboard: inner corners along its rows and columns, and the side of a square, m."""

    columns: int
    rows: int
    square_m: float

    @property
    def points_m(self) -> NDArray[np.float32]:
        """Inner corners, board axes, shape (columns * rows, 3)."""
        grid = np.mgrid[0 : self.columns, 0 : self.rows].T.reshape(-1, 2) * self.square_m
        return np.column_stack((grid, np.zeros(len(grid)))).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """Intrinsics with the data that they are from."""

    camera: Camera
    sigma_px: FloatArray
    """Standard deviations of fx, fy, cx, cy, shape (4,)."""
    rms_px: float
    """RMS distance of the corners from their projections."""
    images: int
    """Number of images."""
    found: int
    """Number of images in which the board was found."""
    used: int
    """Number of images in the fit."""
    covered_share: float
    """Share of the image's 6 x 6 cells that hold a corner."""
    tilt_deg: float
    """Largest tilt of the board against the image."""

    def findings(self) -> Iterator[str]:
        """Yield the intrinsics with their deviations, and what is missing."""
        camera = self.camera
        values = zip(
            ("fx", "fy", "cx", "cy"), (camera.fx, camera.fy, camera.cx, camera.cy), self.sigma_px, strict=True
        )
        yield ", ".join(f"{name} {value:.2f} +- {sigma:.2f}" for name, value, sigma in values) + " px"
        yield "distortion " + ", ".join(f"{value:.4f}" for value in camera.distortion)
        yield (
            f"RMS {self.rms_px:.3f} px; board found in {self.found} of {self.images} images, {self.used} "
            "used, "
            f"corners in {self.covered_share:.0%} of the image, tilted by up to {self.tilt_deg:.0f} deg"
        )
        if self.covered_share < _WELL_COVERED:
            yield "note: distortion is not known where no corner was; move the board into the corners"
        if self.tilt_deg < 20.0:
            yield "note: a board that faces the camera hardly separates focal length from distance; tilt it"
        if self.rms_px > _WORST_RMS_PX:
            yield "note: the RMS is above a pixel: check that the board is flat, and --pattern and --model"


def images_in(folder: Path) -> Iterator[NDArray[np.uint8]]:
    """Yield the images of a folder as grey levels, in the order of their names."""
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() in (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm"):
            image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            if image is None:
                raise CalibrationError(f"{path}: is no image that can be read")
            yield _grey(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image)


def images_of(log: Log, sensor: str) -> Iterator[NDArray[np.uint8]]:
    """Yield the amplitude images of a PMD camera in a log as grey levels.

    Raises:
        CalibrationError: the log has no such camera.
    """
    pmd_camera(log, sensor, option="--sensor", otherwise="a LIDAR has no lens")
    for frame in pmd_frames(log, sensor):
        if frame.amplitude is not None:
            yield _grey(frame.amplitude)


def find_intrinsics(images: Iterable[NDArray[np.uint8]], board: Checkerboard, model: str) -> Intrinsics:
    """Return the intrinsics of the camera that made the images.

    Args:
        images: grey images, shape (height, width).
        board: the checkerboard in them.
        model: ``plumb_bob`` or ``rational_polynomial``.

    Raises:
        CalibrationError: the images are too few or of different sizes, or the board is not found in them.
    """
    views: list[NDArray[np.float32]] = []
    sizes: set[tuple[int, int]] = set()
    count = 0
    for image in images:
        count += 1
        sizes.add((image.shape[1], image.shape[0]))
        corners = _corners(image, board)
        if corners is not None:
            views.append(corners)
    if not count:
        raise CalibrationError(
            "no image: a folder needs images (PNG, JPEG, TIFF, BMP or PGM), a log the amplitude of the camera"
        )
    if len(sizes) > 1:
        raise CalibrationError(f"the images have different sizes: {', '.join(map(str, sorted(sizes)))}")
    if len(views) < _LEAST_IMAGES:
        raise CalibrationError(
            f"the board of {board.columns}x{board.rows} inner corners was found in {len(views)} of {count} "
            "images, "
            f"needs {_LEAST_IMAGES}: check --pattern, light, and that the whole board is in the image"
        )
    size = sizes.pop()
    used = _different(views, least_px=_LEAST_MOVE_SHARE * size[0])
    if len(used) < _LEAST_IMAGES:
        raise CalibrationError(
            f"the board hardly moved: {len(used)} of {len(views)} images differ, needs {_LEAST_IMAGES}: "
            "move and "
            "tilt it between images"
        )
    return _fitted(used, board, size, model, counts=(count, len(views)))


def _grey(image: NDArray[Any]) -> NDArray[np.uint8]:
    finite = np.nan_to_num(np.asarray(image, np.float32))
    white = max(float(np.percentile(finite, _BRIGHTEST)), 1e-6)
    grey: NDArray[np.uint8] = (255.0 * np.sqrt((finite / white).clip(0.0, 1.0))).astype(np.uint8)
    return grey


def _corners(image: NDArray[np.uint8], board: Checkerboard) -> NDArray[np.float32] | None:
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_EXHAUSTIVE
    found, corners = cv2.findChessboardCornersSB(image, (board.columns, board.rows), flags=flags)
    return corners.reshape(-1, 2).astype(np.float32) if found else None


def _different(views: list[NDArray[np.float32]], *, least_px: float) -> list[NDArray[np.float32]]:
    """Return views that differ: each time the one farthest from those that were chosen."""
    chosen = [views[0]]
    away = np.full(len(views), np.inf)
    while len(chosen) < _MOST_IMAGES:
        newest = chosen[-1]
        away = np.minimum(away, [np.linalg.norm(view - newest, axis=1).mean() for view in views])
        farthest = int(np.argmax(away))
        if away[farthest] < least_px:
            break
        chosen.append(views[farthest])
    return chosen


def _fitted(
    views: list[NDArray[np.float32]],
    board: Checkerboard,
    size: tuple[int, int],
    model: str,
    *,
    counts: tuple[int, int],
) -> Intrinsics:
    flags = cv2.CALIB_RATIONAL_MODEL if model == "rational_polynomial" else 0
    rms, K, D, turns, _, sigma, _, _ = cv2.calibrateCameraExtended(
        [board.points_m] * len(views),
        [view[:, None] for view in views],
        size,
        np.eye(3),
        np.zeros(8),
        flags=flags,
    )
    (fx, cx, fy, cy) = K[0, 0], K[0, 2], K[1, 1], K[1, 2]
    normals = [abs(float(cv2.Rodrigues(turn)[0][2, 2])) for turn in turns]
    return Intrinsics(
        camera=Camera(
            width=size[0],
            height=size[1],
            fx=fx,
            fy=fy,
            cx=cx,
            cy=cy,
            distortion=np.asarray(D, np.float64).ravel()[: 8 if flags else 5],
        ),
        sigma_px=sigma.ravel()[:4].astype(np.float64),
        rms_px=float(rms),
        images=counts[0],
        found=counts[1],
        used=len(views),
        covered_share=_covered(views, size),
        tilt_deg=float(np.degrees(np.arccos(min(normals)))),
    )


def _covered(views: list[NDArray[np.float32]], size: tuple[int, int]) -> float:
    corners = np.concatenate(views)
    cells = np.floor(_CELLS * corners / np.array(size)).clip(0, _CELLS - 1).astype(int)
    return len(np.unique(cells, axis=0)) / _CELLS**2
