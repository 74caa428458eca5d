"""Options of ``population``."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from rpod_campaign.engine.options import Model, Provided, SensorOptions, Surroundings, Trials, Worlds
from rpod_schemas.config.base import Positive
from rpod_schemas.config.scenario import Scenario
from rpod_target.population.names import PopulationName


class Options(SensorOptions):
    """Acquisition and tracking of random satellites."""

    title: ClassVar[str] = "Acquisition and tracking of random satellites"

    trials: Trials = 100
    sensor: Literal["lidar", "pmd"] = "lidar"
    """Sensor: lidar, or pmd for the camera, whose satellites are 0.2 to 3 m long."""
    task: Literal["acquisition", "tracking"] = "acquisition"
    """Task: acquisition in single frames without a guess, or tracking from a wrong prediction."""
    population: PopulationName = "report"
    """Satellites: derive, from which limits may be derived, or report, for reported figures only."""
    bodies: Annotated[int, Field(gt=0)] = 30
    """Number of satellites; the seed selects them."""
    target: tuple[Annotated[str, Field(min_length=1)], ...] = ()
    """Targets instead of the random satellites: names, or paths of parameter files."""
    model: Model = None
    returns: tuple[Positive, Positive] = (30.0, 500.0)
    """Least and greatest number of returns of a LIDAR's scan; the range follows from it."""
    filled: tuple[Positive, Positive] = (0.2, 0.8)
    """Least and greatest longest side in the camera's image, over the image's height; the range follows."""
    world: Worlds = ("documented",)
    surroundings: Surroundings = ("none",)
    scenario: str = "tumbling"
    """Scenario with the camera, by name; 'mockup-' may be left out."""
    scenarios: Annotated[dict[str, Scenario], Provided()] = Field(default_factory=dict)
    """Installed scenarios, by name."""
