"""Options of ``pmd-sun``."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from rpod_campaign.engine.options import Model, Trials
from rpod_campaign.pmd.options import Approach, Frames, Methods, PmdOptions, Radii


class Options(PmdOptions):
    """Tracking under every sun, on every material."""

    title: ClassVar[str] = "Tracking under every sun, on every material"

    trials: Trials = 1
    model: Model = None
    ranges: Approach = None
    method: Methods = ("hybrid", "joint")
    radius: Radii = None
    frames: Frames = "keyframes"
    case: Annotated[
        tuple[Literal["as-built", "panel", "gold-mli", "silver-mli"], ...], Field(min_length=1)
    ] = ("as-built", "panel", "gold-mli", "silver-mli")
    """Materials that cover the target; as-built keeps those of its file. Those that it lacks are left out."""
