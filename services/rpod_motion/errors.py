"""Errors that this package raises."""

from rpod_schemas.errors import RpodError


class MotionError(RpodError):
    """Root of the errors that this package raises: a motion cannot be built, or a time is outside it."""
