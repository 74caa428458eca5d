"""The errors of drivers and their host."""

from rpod_schemas.errors import RpodError


class DriverError(RpodError):
    """Root of the errors that this package raises; a driver may raise it for an error of its sensor."""


class SilentSensorError(DriverError):
    """Raised if the sensor delivers no frame."""

    def __init__(self, silence_s: float) -> None:
        super().__init__(f"no frame for {silence_s:.1f} s")


class WrongKindError(DriverError):
    """Raised if the driver delivers frames of another kind than configured."""

    def __init__(self, kind: str, delivered: object) -> None:
        super().__init__(f"kind is {kind!r}, but the driver delivers {type(delivered).__name__}")
