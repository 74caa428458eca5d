"""The static background of each sensor of a log whose frames do not show the target."""

from itertools import chain

import numpy as np

from rpod_analysis.errors import CalibrationError
from rpod_analysis.log import Log
from rpod_analysis.log.sensors import find_sensors, sensor_frames
from rpod_pose.pmd.other_things import PmdFrames
from rpod_pose.surroundings.known import Background
from rpod_schemas.types import Float32Array, LidarScan, PmdFrame, SensorFrame


def learned_backgrounds(log: Log) -> dict[str, Background]:
    """Return the background of each camera and LIDAR of a log, by name.

    Raises:
        CalibrationError: the log has no frame of either.
        rpod_pose.surroundings.known.KnownSurroundingsError: the frames of a sensor differ in size.
    """
    found = {}
    for name, sensor in find_sensors(log).items():
        ranges_m = (
            range_m
            for frame in sensor_frames(log, name, sensor.kind)
            if (range_m := _ranges_m(frame)) is not None
        )
        first_m = next(ranges_m, None)
        if first_m is not None:
            found[name] = Background.learned(chain([first_m], ranges_m))
    if not found:
        raise CalibrationError(f"{log.paths[0].name}: no frames of a PMD camera or an organised LIDAR")
    return found


def _ranges_m(frame: SensorFrame) -> Float32Array | None:
    """Return what ``Frames.every_range_m`` of the kind returns; None for another kind."""
    if isinstance(frame, PmdFrame):
        return PmdFrames().every_range_m(frame)
    if isinstance(frame, LidarScan) and frame.points_m.ndim == 3:
        range_m = np.linalg.norm(frame.points_m, axis=-1)
        return np.where(np.isfinite(range_m), range_m, 0.0).astype(np.float32)
    return None
