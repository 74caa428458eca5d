"""Errors that this package raises."""


class MotionError(Exception):
    """Root of the errors that this package raises: a motion that cannot be built, or a time outside it."""
