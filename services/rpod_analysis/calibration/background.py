"""The static background of each sensor of a log whose frames do not show the target."""

from itertools import chain

from rpod_analysis.errors import CalibrationError
from rpod_analysis.log import Log
from rpod_analysis.log.sensors import find_sensors, sensor_frames
from rpod_pose.surroundings.known import Background


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
            if (range_m := frame.range_image_m) is not None
        )
        first_m = next(ranges_m, None)
        if first_m is not None:
            found[name] = Background.learned(chain([first_m], ranges_m))
    if not found:
        raise CalibrationError(f"{log.paths[0].name}: no frames of a PMD camera or an organised LIDAR")
    return found
