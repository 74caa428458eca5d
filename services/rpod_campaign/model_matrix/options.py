"""Options of ``model-matrix``."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from rpod_campaign.engine.options import Names, Provided, SensorOptions, Trials, Worlds
from rpod_schemas.config.base import Positive
from rpod_schemas.config.scenario import Scenario

VARIATIONS = (
    "@coarse=1%",
    "@coarse=3%",
    "@missing",
    "@bent=5deg",
    "@off=1mm",
    "@off=5mm",
    "@scale=1%",
    "@scale=3%",
)
"""Variations of each target that are tried by default."""


class Options(SensorOptions):
    """Targets that differ from their models."""

    title: ClassVar[str] = "Targets that differ from their models"

    trials: Trials = 50
    sensor: Literal["lidar", "pmd"] = "lidar"
    """Sensor: lidar, or pmd for the camera."""
    target: Names = ("envisat-mesh",)
    """Targets that are seen: names, or paths of parameter files."""
    models: Names = VARIATIONS
    """Models that are looked for, beside the target itself: names, files, or variations of each target."""
    returns: tuple[Positive, Positive] = (30.0, 500.0)
    """Least and greatest number of returns of a LIDAR's scan; the range follows from it."""
    filled: tuple[Positive, Positive] = (0.2, 0.8)
    """Least and greatest longest side in the camera's image, over the image's height; the range follows."""
    world: Worlds = ("documented",)
    scenario: str = "tumbling"
    """Scenario with the camera, by name; 'mockup-' may be left out."""
    scenarios: Annotated[dict[str, Scenario], Provided()] = Field(default_factory=dict)
    """Installed scenarios, by name."""
