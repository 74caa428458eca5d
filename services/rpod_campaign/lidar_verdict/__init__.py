"""Verdicts on right and wrong poses in LIDAR scans."""
