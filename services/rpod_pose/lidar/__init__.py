"""Poses from scans of a LIDAR: search without a guess, tracking, likelihood of a scan."""

from rpod_pose.lidar.single_scan import acquire

__all__ = ["acquire"]
