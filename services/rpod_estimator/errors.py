"""The errors of the estimator."""


class EstimatorError(Exception):
    """Root of the errors that this package raises."""


class ExtrinsicsError(EstimatorError):
    """A sensor's mount is unknown, or told in two ways."""
