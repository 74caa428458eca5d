"""When a pose explains a PMD frame: what of its pixels may contradict it."""

from typing import Annotated

from pydantic import Field

from rpod_schemas.config.base import NonNegative, Positive, Share
from rpod_schemas.config.tuning import BY_HAND, Provenance, Tuning


class PmdCheckConfig(Tuning):
    """Limits that hold at any noise: what contradicts a pose is measured in each pixel's own."""

    tolerance_m: Annotated[Positive, BY_HAND] = 0.06
    """A range is off by more than this where it contradicts, and by more than three times its noise."""
    most_noise_m: Annotated[Positive, BY_HAND] = 0.1
    """A range that is noisier, as its neighbours tell, says nothing: it is of the dark, not of a surface."""
    reach_px: Annotated[Positive, BY_HAND] = 2.5
    """How far off the model's outlines and edges may lie in the image: the pixels that a coarse one takes
    together, mixed ones and the pose's own error."""
    place_m: Annotated[
        NonNegative,
        Provenance("hand, mock-up", "twice 3 mm, by which a target may differ from its file; a guess"),
    ] = 0.006
    """The same on the target, which is not quite built as drawn: twice 3 mm."""
    most_inconsistent_share: Annotated[
        Share,
        Provenance(
            "hand, mock-up", "right poses had up to 0.024 on emulated frames, the sun behind a camera 7 m off"
        ),
    ] = 0.04
    """Of the pixels that say something. Right poses had up to 0.024, the sun behind a camera 7 m off."""
    patch_px: Annotated[int, Field(gt=0), BY_HAND] = 5
    """Side of a square patch of coarse pixels, about a tenth of a metre where no depth is lost: a detail
    that is out of place is small."""
    most_in_patch: Annotated[
        Annotated[int, Field(gt=0)], Provenance("hand, mock-up", "right poses had up to 6 on emulated frames")
    ] = 6
    """Contrary pixels of the fullest patch. Right poses had up to 6. Of 25 pixels, each contrary in one case
    of 50, more than six are in one of a million."""
    most_lacking: Annotated[
        Annotated[int, Field(gt=0)],
        Provenance("hand, mock-up", "right poses had up to 3 on emulated frames, beside glints"),
    ] = 4
    """The same of those that lack a surface. Right poses had up to 3, beside glints."""
