"""Options of ``lidar-tracking``."""

from typing import ClassVar

from rpod_campaign.engine.options import Model, Names, Ranges, Trials
from rpod_campaign.lidar.options import LidarOptions


class Options(LidarOptions):
    """Tracking in LIDAR scans."""

    title: ClassVar[str] = "Tracking in LIDAR scans"

    trials: Trials = 200
    model: Model = None
    ranges: Ranges = (20.0, 30.0, 40.0, 50.0)
    matcher: Names = ("projective", "nearest-neighbour", "normal-shooting")
    """Trackers: projective, nearest-neighbour, normal-shooting, nearest-neighbour-plane."""
