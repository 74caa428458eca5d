"""Options of ``lidar-robustness``."""

from typing import ClassVar

from rpod_campaign.engine.options import Model, Names, Ranges, Trials
from rpod_campaign.lidar.options import LidarOptions, Methods, Steps


class Options(LidarOptions):
    """LIDAR acquisition where world and model differ."""

    title: ClassVar[str] = "LIDAR acquisition where world and model differ"

    trials: Trials = 500
    model: Model = None
    target: Names = ("envisat-bulky", "envisat-slim")
    """Targets: names, or paths of parameter files."""
    ranges: Ranges = (20.0, 50.0)
    method: Methods = ("global",)
    steps: Steps = (30.0,)
