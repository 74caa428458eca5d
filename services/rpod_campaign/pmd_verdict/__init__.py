"""Verdicts on frames of the target and of something else."""
