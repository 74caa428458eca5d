"""Calibration of a PMD camera's distances from logged frames with truth."""
