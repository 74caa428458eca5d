"""Acquisition in LIDAR scans at random attitudes."""
