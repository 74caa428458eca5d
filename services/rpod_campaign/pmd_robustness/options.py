"""Options of ``pmd-robustness``."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from rpod_campaign.engine.options import Model, Trials
from rpod_campaign.pmd.options import Frames, Methods, PmdOptions, Radii, Through


class Options(PmdOptions):
    """Tracking with a wrong model and with lost pixels."""

    title: ClassVar[str] = "Tracking with a wrong model and with lost pixels"

    trials: Trials = 5
    model: Model = None
    method: Methods = ("joint",)
    radius: Radii = None
    frames: Frames = "full"
    through: Through = "tracker"
    case: Annotated[
        tuple[Literal["nominal", "cad-1mm", "cad-3mm", "depth-lost", "glints", "close"], ...],
        Field(min_length=1),
    ] = ("nominal", "cad-1mm", "cad-3mm", "depth-lost", "glints", "close")
    """Differences between world and model, and range of the approach."""
