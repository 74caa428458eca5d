"""Options of ``navigation``."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from rpod_campaign.engine.options import Names, Provided, Trials, Worlds
from rpod_campaign.engine.options import Options as CampaignOptions
from rpod_schemas.config.base import NonNegative, Positive
from rpod_schemas.config.scenario import Scenario


class Options(CampaignOptions):
    """Whether the estimates of a scenario are as good as they state."""

    title: ClassVar[str] = "Scenarios: true covariance, handovers"

    trials: Trials = 200
    scenario: Names = ("mockup-tumbling",)
    """Scenarios: names, or paths of scenario files."""
    target: tuple[Annotated[str, Field(min_length=1)], ...] = ()
    """Targets instead of that of the scenario, with its motion: names, or paths of parameter files."""
    world: Worlds = ("documented",)
    case: Annotated[
        tuple[Literal["scenario", "nominal", "cad-1mm", "cad-3mm", "depth-lost", "glints", "close"], ...],
        Field(min_length=1),
    ] = ("scenario",)
    """The scenario as it is, or a case of pmd-robustness with the scenario's motion and light: calibrated
    cameras, that case's range, parts that are off, and pixels without depth or light."""
    seconds: Positive = 4.0
    """Length of a trial, s; it begins anywhere in the scenario. The scenario's duration or more plays all of
    it."""
    rate: tuple[Positive, ...] = ()
    """Rates of the cameras instead of those of the scenario, Hz; the other sensors keep theirs."""
    off_mm: Annotated[tuple[NonNegative, ...], Field(min_length=1)] = (0.0,)
    """How far the target is off its model, one standard deviation, mm."""
    misbuilt: Annotated[tuple[Literal["parts", "surface"], ...], Field(min_length=1)] = ("parts",)
    """What is off: places and sizes of the parts, or each coordinate of the whole surface, of which near
    places have nearly the same error, as tolerance_m of a target's file declares it."""
    declared: Annotated[tuple[Positive, ...], Field(min_length=1)] = (1.0,)
    """Tolerance that the model declares, over the true one; 1 is right."""
    mounts: Annotated[tuple[Literal["stated", "drawn"], ...], Field(min_length=1)] = ("stated",)
    """Mounts that the sensors publish: those of the scenario, or the true ones with a random error in each
    trial. Its standard deviations are the filter's mount_sigma_deg and mount_sigma_m."""
    motion: Annotated[tuple[Literal["scenario", "driven"], ...], Field(min_length=1)] = ("scenario",)
    """Motion of the target: that of the scenario, or the same with white accelerations, whose densities are
    those of the filter."""
    scenarios: Annotated[dict[str, Scenario], Provided()] = Field(default_factory=dict)
    """Scenarios, by name and by path."""
