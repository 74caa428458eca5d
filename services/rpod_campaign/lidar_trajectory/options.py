"""Options of ``lidar-trajectory``."""

from typing import ClassVar

from rpod_campaign.engine.options import Names, Trials
from rpod_campaign.lidar.options import Centroid, Eq4, LidarOptions, Methods, Steps


class Options(LidarOptions):
    """Template matching along a safety ellipse."""

    title: ClassVar[str] = "Template matching along a safety ellipse"

    trials: Trials = 241
    target: Names = ("envisat-bulky", "envisat-slim")
    """Targets: names, or paths of parameter files."""
    method: Methods = ("template-matching", "fast-template-matching")
    steps: Steps = (60.0, 40.0, 30.0, 20.0, 10.0)
    eq4: Eq4 = "both"
    centroid: Centroid = "plain"
