"""The errors of emulated sensors."""

from rpod_schemas.errors import RpodError


class SimSensorError(RpodError):
    """Root of the errors that this package raises."""
