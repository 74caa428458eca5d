"""The errors of the estimator."""

from rpod_schemas.errors import RpodError


class EstimatorError(RpodError):
    """Root of the errors that this package raises."""
