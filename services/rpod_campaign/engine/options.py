"""The options of a campaign: one frozen model, from which the command line and its help are made.

An option's type, default, bounds and help sentence are defined in the campaign's model alone. The sentence is
the docstring under the field, or the ``description`` of a type that several campaigns share.
"""

from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import ConfigDict, Field

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


def either(chosen: str, two: tuple[str, str]) -> tuple[str, ...]:
    """Return the values that an option selects: itself, or the two values that ``both`` selects."""
    return two if chosen == "both" else (chosen,)


def choices(annotation: Any) -> tuple[str, ...]:
    """Return the values of a ``Literal``, also inside a tuple or beside None; nothing for other types."""
    if getattr(annotation, "__origin__", None) is Literal:
        return get_args(annotation)
    inner = [choices(argument) for argument in get_args(annotation)]
    return next((found for found in inner if found), ())
