"""Acceptance of frames of the target and of other objects."""
