"""Verdicts on frames of the target and of other objects."""
