"""Options of ``faults``."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from rpod_campaign.engine.options import Names, Provided, Trials, Worlds
from rpod_campaign.engine.options import Options as CampaignOptions
from rpod_campaign.faults.matrix import DEFAULTS
from rpod_schemas.config.scenario import Scenario


class Options(CampaignOptions):
    """Faults of the catalogue by kind and size: shares of modes, loss of the track, wrong estimates."""

    title: ClassVar[str] = "Faults by kind and size, and their effects"

    trials: Trials = 2
    target: Names = ("mockup",)
    """Targets: names, or paths of parameter files."""
    sensor: Annotated[tuple[Literal["lidar", "pmd"], ...], Field(min_length=1)] = ("pmd",)
    """Sensors: a LIDAR at 1 Hz, or a calibrated camera at 15 Hz."""
    fault: Names = DEFAULTS
    """Faults, by their names in the catalogue."""
    world: Worlds = ("documented",)
    scenarios: Annotated[dict[str, Scenario], Provided()] = Field(default_factory=dict)
    """Installed scenarios, by name."""
