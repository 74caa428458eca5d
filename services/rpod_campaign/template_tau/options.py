"""Options of ``template-tau``."""

from typing import Annotated, ClassVar

from pydantic import Field

from rpod_campaign.engine.options import Ranges, Trials
from rpod_campaign.lidar.options import LidarOptions, Steps
from rpod_schemas.config.base import Positive


class Options(LidarOptions):
    """The choice of tau for the fast template matching."""

    title: ClassVar[str] = "The choice of tau for the fast template matching"

    trials: Trials = 100
    ranges: Ranges = (20.0, 50.0)
    steps: Steps = (30.0,)
    taus: Annotated[tuple[Positive, ...], Field(min_length=1)] = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 1.0)
    """Compared limits of the relative difference of spreads, tau in Eq. 3 of the 2015 paper."""
