"""Integrity: faults of sensors and models, and whether the estimator reports them in time."""
