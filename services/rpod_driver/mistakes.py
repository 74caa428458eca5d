"""Mistakes of drivers that leave frames which look right, and what undoes each of them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from rpod_schemas.types import LidarScan, PmdFrame, SensorFrame


@dataclass(frozen=True)
class Mistake:
    """A mistake of a driver, and the function that undoes it."""

    fault: str
    """Name in the catalogue."""
    text: str
    """Description of frames in which it is undone, after "found in 8"."""
    undo: Callable[[Any], SensorFrame]


def mirrored_scan(scan: LidarScan) -> LidarScan:
    """Return a scan with left and right exchanged; reversed rows differ from it by a half turn only."""
    points_m = scan.points_m * np.array([-1.0, 1.0, 1.0], np.float32)
    parts = {"points_m": points_m, "intensity": scan.intensity, "time_s": scan.time_s}
    if scan.organised:
        parts = {name: None if part is None else part[:, ::-1] for name, part in parts.items()}
    return scan.model_copy(update=parts)


def mirrored_image(frame: PmdFrame) -> PmdFrame:
    """Return a frame with left and right exchanged; reversed rows differ from it by a half turn only."""
    images = {name: getattr(frame, name) for name in ("depth_m", "amplitude", "saturated")}
    turned = {
        name: None if image is None else np.ascontiguousarray(image[:, ::-1])
        for name, image in images.items()
    }
    camera = frame.camera.model_copy(update={"cx": frame.camera.width - 1 - frame.camera.cx})
    return frame.model_copy(update=turned | {"camera": camera})


def refocused(factor: float) -> Callable[[PmdFrame], PmdFrame]:
    """Return what multiplies the focal lengths of a frame."""

    def undo(frame: PmdFrame) -> PmdFrame:
        focal = {"fx": frame.camera.fx * factor, "fy": frame.camera.fy * factor}
        return frame.model_copy(update={"camera": frame.camera.model_copy(update=focal)})

    return undo


_MIRRORED = "mirrored, or with rows or columns in reverse order"
MIRRORED_SCAN = Mistake("mirrored", _MIRRORED, mirrored_scan)
MIRRORED_IMAGE = Mistake("mirrored", _MIRRORED, mirrored_image)
FOCAL_LENGTHS = tuple(
    Mistake("lens_unscaled", f"with {factor:g} times the focal length", refocused(factor))
    for factor in (0.5, 2.0)
)
"""Focal lengths of another mode of the camera."""
