"""Options of ``pmd-acceptance``."""

from typing import Annotated, ClassVar, Literal, get_args

from pydantic import Field

from rpod_campaign.engine.options import Ranges, Trials
from rpod_campaign.pmd.options import PmdOptions

CaseName = Literal[
    "right",
    "dual",
    "sun-behind",
    "depth-lost",
    "glints",
    "all-panel",
    "all-gold-mli",
    "all-silver-mli",
    "left-right",
    "upside-down",
    "focal-0.8",
    "focal-0.9",
    "focal-1.1",
    "focal-1.2",
    "size-0.9",
    "size-1.1",
    "hexagonal-body",
    "rocket-stage",
    "envisat-slim",
]


class Options(PmdOptions):
    """Acceptance of frames of the target and of other objects."""

    title: ClassVar[str] = "Acceptance of frames of target and other objects"

    trials: Trials = 100
    ranges: Ranges = (2.1, 7.0)
    case: Annotated[tuple[CaseName, ...], Field(min_length=1)] = get_args(CaseName)
    """Contents of the frame, or changes to it."""
