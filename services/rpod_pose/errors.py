"""The errors of pose estimation."""


class PoseError(Exception):
    """Root of the errors that this package raises."""
