"""Calibration of mount and clock on emulated minutes with known errors, over seeds."""
