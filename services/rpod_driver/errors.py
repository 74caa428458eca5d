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


class NotSupportedError(DriverError):
    """A driver is asked for what it does not have."""

    def __init__(self, sensor: str, what: str, methods: str) -> None:
        super().__init__(f"the driver of {sensor!r} has no {what}: it needs the methods {methods}")


class NoAnswerError(DriverError):
    """The device does not answer a request in time."""

    def __init__(self, sensor: str, waited_s: float) -> None:
        super().__init__(f"no answer of {sensor!r} after {waited_s:g} s; is its device connected?")
