"""Acquisition in LIDAR scans over range and scan step."""
