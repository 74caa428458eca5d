"""Scenarios through the navigator: whether the covariance is true, what is available, and handovers."""
