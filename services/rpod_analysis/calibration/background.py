"""The static background of each sensor of a log whose frames do not show the target."""

from itertools import chain
from typing import NamedTuple

from rpod_analysis.errors import CalibrationError, NoFramesError
from rpod_analysis.log import Log
from rpod_analysis.log.sensors import find_sensors, sensor_frames
from rpod_pose.surroundings.known import Background

_LEAST_FRAMES = 10
"""Least number of frames: with it the standard deviation of a pixel is known to a third."""
_NO_FRAME = "no complete frame of it is in the log: check its topics with 'rpod driver check'"
_NO_IMAGE = "its frames are no image of ranges: let the driver of a LIDAR publish rows and columns"


class Learned(NamedTuple):
    """The backgrounds that a log shows."""

    backgrounds: dict[str, Background]
    """Background by sensor."""
    left_out: dict[str, str]
    """Why a sensor of the log has none, by its name, with the remedy."""


def learned_backgrounds(log: Log) -> Learned:
    """Return the background of each camera and LIDAR of a log.

    Raises:
        CalibrationError: the log has no frame of either, or too few of a sensor.
        rpod_pose.surroundings.known.KnownSurroundingsError: the frames of a sensor differ in size.
    """
    sensors = find_sensors(log)
    if not sensors:
        raise NoFramesError(log.paths[0].name)
    found: dict[str, Background] = {}
    left_out: dict[str, str] = {}
    for name, sensor in sensors.items():
        background = _background(log, name, sensor.kind)
        if isinstance(background, Background):
            found[name] = background
        else:
            left_out[name] = background
    if not found:
        reasons = "; ".join(f"{name!r}: {reason}" for name, reason in sorted(left_out.items()))
        raise CalibrationError(f"{log.paths[0].name}: no sensor shows a background. {reasons}")
    return Learned(found, left_out)


def _background(log: Log, name: str, kind: str) -> Background | str:
    """Return the background of a sensor, or why it has none."""
    frames = sensor_frames(log, name, kind)
    first = next(frames, None)
    if first is None:
        return _NO_FRAME
    ranges_m = (range_m for frame in chain([first], frames) if (range_m := frame.range_image_m) is not None)
    first_m = next(ranges_m, None)
    if first_m is None:
        return _NO_IMAGE
    background = Background.learned(chain([first_m], ranges_m))
    if background.frames < _LEAST_FRAMES:
        raise CalibrationError(
            f"{log.paths[0].name}: {background.frames} frames of {name!r}, needs {_LEAST_FRAMES} to know the "
            "noise of each pixel: log for longer"
        )
    return background
