"""Acquisition in one frame of a PMD camera."""
