"""The errors of drivers and their host."""

from rpod_schemas.errors import RpodError


class DriverError(RpodError):
    """Root of the errors that this package raises; a driver may raise it for an error of its sensor."""


class SilentSensorError(DriverError):
    """The sensor delivers no frame."""

    def __init__(self, silence_s: float) -> None:
        super().__init__(f"no frame for {silence_s:.1f} s; check the sensor's power and connection")


class WrongKindError(DriverError):
    """The driver delivers frames, or an info, of another kind than configured."""

    def __init__(self, kind: str, delivered: object) -> None:
        super().__init__(
            f"kind is {kind!r}, but the driver delivers {type(delivered).__name__}; correct kind"
        )
