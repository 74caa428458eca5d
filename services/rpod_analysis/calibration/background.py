"""The static background of each sensor of a log whose frames do not show the target."""

from itertools import chain

from rpod_analysis.errors import CalibrationError, NoFramesError
from rpod_analysis.log import Log
from rpod_analysis.log.sensors import find_sensors, sensor_frames
from rpod_pose.surroundings.known import Background

_LEAST_FRAMES = 10
"""Least number of frames: with it the standard deviation of a pixel is known to a third."""


def learned_backgrounds(log: Log) -> dict[str, Background]:
    """Return the background of each camera and LIDAR of a log, by name.

    Raises:
        CalibrationError: the log has no frame of either.
        rpod_pose.surroundings.known.KnownSurroundingsError: the frames of a sensor differ in size.
    """
    found, sensors = {}, find_sensors(log)
    for name, sensor in sensors.items():
        ranges_m = (
            range_m
            for frame in sensor_frames(log, name, sensor.kind)
            if (range_m := frame.range_image_m) is not None
        )
        first_m = next(ranges_m, None)
        if first_m is not None:
            found[name] = Background.learned(chain([first_m], ranges_m))
            if found[name].frames < _LEAST_FRAMES:
                raise CalibrationError(
                    f"{log.paths[0].name}: {found[name].frames} frames of {name!r}, needs {_LEAST_FRAMES} to "
                    "know the noise of each pixel: log for longer"
                )
    if not sensors:
        raise NoFramesError(log.paths[0].name)
    if not found:
        raise CalibrationError(
            f"{log.paths[0].name}: no frames of a PMD camera or an organised LIDAR; its sensors are "
            f"{', '.join(sorted(sensors))}: let the driver of a LIDAR publish rows and columns"
        )
    return found
