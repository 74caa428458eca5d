"""Acquisition in LIDAR scans of a world that differs from the method's model."""
