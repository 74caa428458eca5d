"""The errors of emulated sensors."""


class SimSensorError(Exception):
    """Root of the errors that this package raises."""
