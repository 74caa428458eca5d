"""The errors of drivers and their host."""

from pathlib import Path

from rpod_schemas.errors import RpodError


class DriverError(RpodError):
    """Root of the errors that this package raises; a driver may raise it for an error of its sensor."""


class SilentSensorError(DriverError):
    """The sensor delivers no frame."""

    def __init__(self, silence_s: float) -> None:
        super().__init__(f"no frame for {silence_s:.1f} s; check the sensor's power and connection")


class StoppedError(DriverError):
    """A driver was stopped before its device was open; it is no fault."""

    def __init__(self, sensor: str) -> None:
        super().__init__(f"the driver of {sensor!r} was stopped before its device was open")


class WrongKindError(DriverError):
    """The driver delivers frames, or an info, of another kind than configured."""

    def __init__(self, kind: str, delivered: object) -> None:
        super().__init__(
            f"kind is {kind!r}, but the driver delivers {type(delivered).__name__}; deliver what this "
            "kind has (pmd: PmdFrame, lidar: LidarScan), or correct kind"
        )


class MissingSdkError(DriverError):
    """The library of a device is not installed, or cannot be loaded."""

    def __init__(self, driver: str, reason: str, needs: str) -> None:
        super().__init__(f"the driver {driver!r} cannot load a library that it needs ({reason}); {needs}")


class RecordingError(DriverError):
    """A recording of a device cannot be used."""

    def __init__(self, path: Path | str, reason: str) -> None:
        super().__init__(f"{path}: {reason}")


class ForeignDriverError(DriverError):
    """The process of a driver with an environment of its own failed."""

    def __init__(self, command: str, reason: str, tail: tuple[str, ...] = ()) -> None:
        said = "".join(f"\n    {line}" for line in tail)
        super().__init__(f"driver process {command!r} {reason}" + (f"; it said last:{said}" if said else ""))


class NotSupportedError(DriverError):
    """A driver does not support a request."""

    def __init__(self, sensor: str, what: str, methods: str) -> None:
        super().__init__(f"the driver of {sensor!r} has no {what}: it needs the methods {methods}")


class NoAnswerError(DriverError):
    """The device does not answer a request in time."""

    def __init__(self, sensor: str, waited_s: float) -> None:
        super().__init__(f"no answer of {sensor!r} after {waited_s:g} s; is its device connected?")
