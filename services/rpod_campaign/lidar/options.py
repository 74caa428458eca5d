"""Options that the LIDAR campaigns share; each campaign's own model has its defaults."""

from typing import Annotated, Literal

from pydantic import Field

from rpod_campaign.engine.options import Names, Options, Surroundings, Worlds

Steps = Annotated[
    tuple[Annotated[float, Field(ge=5, le=90)], ...],
    Field(min_length=1, description="Steps of the template grid, deg; for template matching only."),
]
Methods = Annotated[
    Names,
    Field(
        description="Methods of acquisition: template-matching, fast-template-matching, "
        "cued-template-matching, global, starved-global."
    ),
]
Matchers = Annotated[
    Names,
    Field(
        description="Pairing of points in the ICP after template matching: nearest-neighbour, "
        "normal-shooting, nearest-neighbour-plane."
    ),
]
Eq4 = Annotated[
    Literal["usual", "printed", "both"],
    Field(description="Reading of Eq. 4 of the 2015 paper, the threshold of detection."),
]
Sampling = Annotated[
    Literal["euler", "so3", "both"],
    Field(description="Distribution of the attitudes: uniform Euler angles as in the 2015 paper, or SO(3)."),
]
Centroid = Annotated[
    Literal["plain", "offset", "both"],
    Field(
        description="Position of template matching: the scan's centroid, or the same corrected by the "
        "template's own offset."
    ),
]
EQ4 = ("usual", "printed")
SAMPLING = ("euler", "so3")
CENTROID = ("plain", "offset")
"""Values that ``both`` selects."""


class LidarOptions(Options):
    """Options of every LIDAR campaign."""

    target: Names = ("envisat-bulky",)
    """Targets: names, or paths of parameter files."""
    world: Worlds = ("documented",)
    surroundings: Surroundings = ("none",)
