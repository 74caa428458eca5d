"""Faults of the catalogue, and how the estimator behaves during and after them."""
