"""Acceptance of right and wrong poses in LIDAR scans."""
