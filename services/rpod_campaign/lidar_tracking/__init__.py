"""Tracking in LIDAR scans."""
