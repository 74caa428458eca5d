"""Options of ``lidar-acquisition``."""

from typing import ClassVar

from rpod_campaign.engine.options import Model, Ranges, Trials
from rpod_campaign.lidar.options import Centroid, Eq4, LidarOptions, Matchers, Methods, Sampling, Steps


class Options(LidarOptions):
    """LIDAR acquisition at random attitudes."""

    title: ClassVar[str] = "LIDAR acquisition at random attitudes"

    trials: Trials = 500
    model: Model = None
    ranges: Ranges = (20.0, 30.0, 40.0, 50.0)
    method: Methods = ("template-matching", "fast-template-matching", "global")
    steps: Steps = (30.0,)
    eq4: Eq4 = "usual"
    sampling: Sampling = "euler"
    centroid: Centroid = "plain"
    matcher: Matchers = ("nearest-neighbour",)
