"""The options of a campaign: one frozen model, from which the command line and its help are made.

An option's type, default, bounds and help sentence are defined in the campaign's model alone. The sentence is
the docstring under the field, or the ``description`` of a type that several campaigns share.
"""

from typing import Annotated, Any, ClassVar, Literal, Self, get_args

from pydantic import ConfigDict, Field, model_validator

from rpod_campaign.engine.trial.surroundings import SurroundingsName
from rpod_schemas.config.base import Config, Positive
from rpod_schemas.config.emulator import WorldName

Trials = Annotated[int, Field(gt=0, description="Number of trials of each cell.")]
Names = Annotated[tuple[Annotated[str, Field(min_length=1)], ...], Field(min_length=1)]
Sizes = Annotated[str, Field(pattern=r"^([0-9]*[1-9][0-9]*(\.[0-9]+)?|[0-9]*\.[0-9]*[1-9][0-9]*)x$")]
"""A length in longest sides of the target, such as 5x; not 0."""
Ranges = Annotated[
    tuple[Positive | Sizes, ...],
    Field(
        min_length=1,
        description="Ranges of the target's origin from the sensor: in m, or in its longest sides, such as "
        "5x. For a target that is no shipped one, they follow from the sensor if they are not given.",
    ),
]


Model = Annotated[
    str | None,
    Field(
        min_length=1,
        description="Model of the targets that the estimator looks for, if it is not the target itself: a "
        "name, a file, or only the terms of a variation of each target, such as @bent=5deg.",
    ),
]
Worlds = Annotated[
    tuple[WorldName, ...],
    Field(
        min_length=1,
        description="Variants of the emulated sensors' physics (rpod_sim_sensor.worlds); unknown to methods.",
    ),
]


Surroundings = Annotated[
    tuple[SurroundingsName, ...],
    Field(
        min_length=1,
        description="Things around the target, unknown to methods: arm is the end of an arm that holds it, "
        "and nothing else; laboratory is a room, a stand and an arm; occluded is a room and a plate that "
        "hides a half of it.",
    ),
]


class Provided:
    """Mark of a field that the program fills in; the command line has no option for it."""


class Options(Config):
    """Options of every campaign."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    title: ClassVar[str] = ""
    """Title of the campaign, one line."""

    trials: Trials = 1
    seed: Annotated[int, Field(ge=0)] = 1
    """Seed of all random numbers."""


class SensorOptions(Options):
    """Options of a campaign of which some count for one sensor, or for random satellites, only."""

    sensor: Literal["lidar", "pmd"] = "lidar"
    """Sensor: lidar, or pmd for the camera."""

    @model_validator(mode="after")
    def _each_counts(self) -> Self:
        """Refuse an option that would be ignored, a pair that falls, and percentages."""
        for name in ("returns", "filled"):
            least, greatest = getattr(self, name)
            if least > greatest:
                raise ValueError(f"--{name} needs the least value first, not {least:g},{greatest:g}")
            if name == "filled" and greatest > _MOST_FILLED:
                raise ValueError(
                    f"--filled is {least:g},{greatest:g}; it needs shares of the image's height up to "
                    f"{_MOST_FILLED:g}, such as 0.2,0.8"
                )
        for other, names in self._ignored().items():
            for name in names & self.model_fields_set:
                raise ValueError(f"--{name} has no meaning with --{other}; leave it out")
        return self

    def meant(self, *, without: set[str]) -> dict[str, Any]:
        """Return the options that count, by name, for the model of another campaign."""
        return self.model_dump(exclude=without.union(*self._ignored().values()))

    def _ignored(self) -> dict[str, set[str]]:
        """Return the names of the options that do not count, by the option because of which they do not."""
        return {
            f"sensor {self.sensor}": {"returns"} if self.sensor == "pmd" else {"filled", "scenario"},
            "target": {"bodies", "population"} if getattr(self, "target", ()) else set(),
        }


_MOST_FILLED = 10.0
"""Greatest ratio of the longest side to the image's height; beyond it, a hundredth of the target is seen."""


def either(chosen: str, two: tuple[str, str]) -> tuple[str, ...]:
    """Return the values that an option selects: itself, or the two values that ``both`` selects."""
    return two if chosen == "both" else (chosen,)


def choices(annotation: Any) -> tuple[str, ...]:
    """Return the values of a ``Literal``, also inside a tuple or beside None; nothing for other types."""
    if getattr(annotation, "__origin__", None) is Literal:
        return get_args(annotation)
    inner = [choices(argument) for argument in get_args(annotation)]
    return next((found for found in inner if found), ())
