"""Options of ``lidar-acceptance``."""

from typing import ClassVar

from rpod_campaign.engine.options import Names, Ranges, Trials
from rpod_campaign.lidar.options import LidarOptions, Methods, Steps


class Options(LidarOptions):
    """Acceptance of right and wrong poses."""

    title: ClassVar[str] = "Acceptance of right and wrong poses"

    trials: Trials = 200
    target: Names = ("envisat-slim", "envisat-bulky", "envisat-mesh", "mockup", "rocket-stage")
    """Targets that are searched: names, or paths of parameter files."""
    ranges: Ranges = (20.0, 50.0)
    method: Methods = ("template-matching", "global", "starved-global")
    steps: Steps = (30.0,)
