"""The errors of pose estimation."""

from rpod_schemas.errors import RpodError


class PoseError(RpodError):
    """Root of the errors that this package raises."""
