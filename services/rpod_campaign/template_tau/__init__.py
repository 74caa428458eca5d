"""The choice of tau for the fast variant of template matching."""
