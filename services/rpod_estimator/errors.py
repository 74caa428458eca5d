"""The errors of the estimator."""


class EstimatorError(Exception):
    """Root of the errors that this package raises."""
