"""Options that the campaigns of the PMD camera share; each campaign's own model has its defaults."""

from typing import Annotated, Literal

from pydantic import Field

from rpod_campaign.engine.options import Names, Options, Provided, Ranges, Surroundings, Worlds
from rpod_schemas.config.scenario import Scenario

Methods = Annotated[
    Names,
    Field(
        description="Methods of tracking: icp-reverse-calibration, icp-reverse-calibration-plane, epnp, "
        "hybrid, signed-distance, joint."
    ),
]
Radii = Annotated[
    Annotated[tuple[Annotated[int, Field(gt=0)], ...], Field(min_length=1)] | None,
    Field(description="Radii of the neighbour search of ICP with reverse calibration, pixels."),
]
Approach = Annotated[
    Ranges | None,
    Field(
        description="Ranges between which the target approaches: in m, or in its longest sides, such as 5x. "
        "By default those of the scenario; for another target, those at which it fills 20 to 80 % of the "
        "image's height."
    ),
]
Frames = Annotated[
    Literal["keyframes", "full", "both"],
    Field(description="Images of a sequence: one a second, or as many as the camera takes."),
]
Through = Annotated[
    Literal["tracker", "truth", "navigator", "both"],
    Field(
        description="First guess of an image: the last estimate, the last true pose, or the navigator's "
        "prediction; both is tracker and navigator."
    ),
]
FRAMES = ("keyframes", "full")
THROUGH = ("tracker", "navigator")
DEPTH = ("raw", "calibrated")
"""Values that ``both`` selects."""


class PmdOptions(Options):
    """Options of every campaign of the camera."""

    scenario: Names = ("tumbling",)
    """Scenarios with the camera, by name; 'mockup-' may be left out."""
    target: tuple[Annotated[str, Field(min_length=1)], ...] = ()
    """Targets instead of that of the scenario: names, or paths of parameter files."""
    world: Worlds = ("documented",)
    surroundings: Surroundings = ("none",)
    scenarios: Annotated[dict[str, Scenario], Provided()] = Field(default_factory=dict)
    """Installed scenarios, by name."""
