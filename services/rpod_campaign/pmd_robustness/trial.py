"""The worlds, and the approaches in them, in which a target is tracked."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from rpod_campaign.pmd.sequence import SCHEMA, run
from rpod_campaign.pmd.world import World

__all__ = ["CASES", "END_M", "LEAVES_M", "SCHEMA", "START_M", "Case", "run"]

START_M, LEAVES_M, END_M = 7.0, 2.1, 1.0
"""Range at the start, at which the target begins to leave the image, and at the end, m."""


@dataclass(frozen=True)
class Case:
    """A world, and an approach in it."""

    about: str
    world: World
    range_m: tuple[float, float] = (START_M, LEAVES_M)
    """Range at the start and at the end, m."""
    pair: str | None = field(default=None)
    """Name of the case with the same frames without the disturbance."""


_1_MM = 1e-3
CASES: Mapping[str, Case] = {
    "nominal": Case("as the estimator assumes", World()),
    "cad-1mm": Case("parts 1 mm off in place and size", World(cad_error_m=_1_MM)),
    "cad-3mm": Case("parts 3 mm off in place and size", World(cad_error_m=3e-3)),
    "depth-lost": Case(
        "1 mm, 60 % of the depth lost in patches",
        World(cad_error_m=_1_MM, depth_lost_share=0.6),
        pair="cad-1mm",
    ),
    "glints": Case(
        "1 mm, glints wipe both images over 40 % of the target",
        World(cad_error_m=_1_MM, glint_share=0.4),
        pair="cad-1mm",
    ),
    "close": Case("1 mm, the target leaves the image", World(cad_error_m=_1_MM), (LEAVES_M, END_M)),
}
"""Cases by their name on the command line."""
