"""The PMD camera that a calibration asks for in a log, or the reason why the log has none."""

from rpod_analysis.errors import CalibrationError, NoFramesError
from rpod_analysis.log import Log
from rpod_analysis.log.sensors import Sensor, find_sensors


def pmd_camera(log: Log, name: str, *, option: str, otherwise: str) -> Sensor:
    """Return a PMD camera of a log.

    Args:
        log: the log.
        name: name of the camera.
        option: option of the command that names it.
        otherwise: what to do for sensors of another kind.

    Raises:
        CalibrationError: the log has no frames of it.
    """
    sensors, file = find_sensors(log), log.paths[0].name
    if not sensors:
        raise NoFramesError(file)
    sensor = sensors.get(name)
    if sensor is not None and sensor.kind == "pmd":
        return sensor
    held = ", ".join(f"{other} ({found.kind})" for other, found in sorted(sensors.items()))
    cameras = sorted(other for other, found in sensors.items() if found.kind == "pmd")
    remedy = f"give {option} {cameras[0]}" if cameras else f"log a PMD camera; {otherwise}"
    raise CalibrationError(
        f"{file}: no frames of a PMD camera called {name!r}; its sensors are {held}: {remedy}"
    )
