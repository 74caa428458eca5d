"""Integrity: faults of sensors and models, and whether the estimator tells them in time."""
