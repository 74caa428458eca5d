"""Options of ``pmd-acquisition``."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from rpod_campaign.engine.options import Model, Names, Ranges, Trials
from rpod_campaign.pmd.options import PmdOptions


class Options(PmdOptions):
    """Acquisition in one image of a PMD camera."""

    title: ClassVar[str] = "Acquisition in one image of a PMD camera"

    trials: Trials = 500
    model: Model = None
    ranges: Ranges = (3.0, 6.0)
    method: Names = ("default",)
    """Methods of tracking that refine the search's pose; default is the facility's."""
    case: Annotated[tuple[Literal["front", "all", "front-wide", "all-wide"], ...], Field(min_length=1)] = (
        "front",
        "all",
        "front-wide",
        "all-wide",
    )
    """Views of the target, and whether the search starts from a wrong guess (wide) or without one."""
