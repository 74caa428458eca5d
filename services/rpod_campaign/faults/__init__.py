"""Faults of the catalogue, and what the estimator does during them and after."""
