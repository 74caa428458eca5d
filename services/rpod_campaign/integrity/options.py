"""Options of ``integrity``."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from rpod_campaign.engine.options import Names, Provided, Trials, Worlds
from rpod_campaign.engine.options import Options as CampaignOptions
from rpod_campaign.integrity.faults import FAULT_NAMES
from rpod_campaign.sequences.course import PMD_HZ
from rpod_schemas.config.base import Positive
from rpod_schemas.config.scenario import Scenario


class Options(CampaignOptions):
    """Faults of sensors and models, and whether the estimator reports them in time."""

    title: ClassVar[str] = "Integrity: faults, protection levels and alerts"

    trials: Trials = 200
    target: Names = ("mockup",)
    """Targets: names, or paths of parameter files."""
    sensor: Annotated[tuple[Literal["lidar", "pmd", "both"], ...], Field(min_length=1)] = (
        "lidar",
        "pmd",
        "both",
    )
    """Sensors: a LIDAR at 1 Hz, a calibrated camera, or both, of which the camera has the fault
    in its middle size."""
    fault: Names = FAULT_NAMES
    """Faults: none, half_turn, wrong_target, wrong_scale, mount_off, clock_behind, clock_off, frozen,
    range_drift."""
    rate: Positive = PMD_HZ
    """Rate of the camera, Hz."""
    world: Worlds = ("documented",)
    scenarios: Annotated[dict[str, Scenario], Provided()] = Field(default_factory=dict)
    """Installed scenarios, by name."""
