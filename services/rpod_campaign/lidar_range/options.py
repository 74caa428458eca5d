"""Options of ``lidar-range``."""

from typing import Annotated, ClassVar

from pydantic import Field

from rpod_campaign.engine.options import Model, Ranges, Trials
from rpod_campaign.lidar.options import LidarOptions, Methods, Steps
from rpod_schemas.config.base import Positive


class Options(LidarOptions):
    """LIDAR acquisition over range and scan step."""

    title: ClassVar[str] = "LIDAR acquisition over range and scan step"

    trials: Trials = 200
    model: Model = None
    ranges: Ranges = (20.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 120.0)
    scan_steps: Annotated[tuple[Positive, ...], Field(min_length=1)] = (1.0, 0.5, 0.2, 0.1)
    """Steps of the scan, deg; each must divide 2 deg."""
    method: Methods = ("global",)
    steps: Steps = (30.0,)
