"""The errors of this package."""

from rpod_schemas.errors import RpodError


class MotionError(RpodError):
    """Root of the errors that this package raises: a motion that cannot be built, or a time outside it."""
