"""Options of ``limits``."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from rpod_campaign.engine.options import Provided, SensorOptions, Trials, Worlds
from rpod_schemas.config.base import NonNegative, Positive
from rpod_schemas.config.scenario import Scenario


class Options(SensorOptions):
    """Limits of evidence, from a population from which limits may be derived."""

    title: ClassVar[str] = "Limits from right and wrong poses"

    trials: Trials = 20
    sensor: Literal["lidar", "pmd"] = "lidar"
    """Sensor: lidar, or pmd for the camera, whose satellites are 0.2 to 3 m long."""
    bodies: Annotated[int, Field(gt=0)] = 30
    """Number of satellites, of those from which limits may be derived; the seed selects them."""
    target: tuple[Annotated[str, Field(min_length=1)], ...] = ()
    """Targets instead of the random satellites: names, or paths of parameter files."""
    quantile: Annotated[float, Field(gt=0.5, lt=1)] = 0.995
    """Share of right poses that each limit lets pass, before the margin."""
    margin: NonNegative = 0.1
    """Share by which a limit is wider than the quantile."""
    returns: tuple[Positive, Positive] = (30.0, 500.0)
    """Least and greatest number of returns of a LIDAR's scan; the range follows from it."""
    filled: tuple[Positive, Positive] = (0.2, 0.8)
    """Least and greatest longest side in the camera's image, over the image's height; the range follows."""
    world: Worlds = ("documented", "lambertian", "noisy", "multipath", "faint")
    scenario: str = "tumbling"
    """Scenario with the camera, by name; 'mockup-' may be left out."""
    scenarios: Annotated[dict[str, Scenario], Provided()] = Field(default_factory=dict)
    """Installed scenarios, by name."""
