"""When a pose explains a PMD frame: what of its pixels may contradict it."""

from typing import Annotated

from pydantic import Field

from rpod_schemas.config.base import Config, Positive, Share


class PmdCheckConfig(Config):
    """Limits that hold at any noise: what contradicts a pose is measured in each pixel's own."""

    tolerance_m: Positive = 0.06
    """A range is off by more than this where it contradicts, and by more than three times its noise."""
    most_noise_m: Positive = 0.1
    """A range that is noisier, as its neighbours tell, says nothing: it is of the dark, not of a surface."""
    most_contrary_share: Share = 0.04
    """Of the pixels that say something. Right poses had up to 0.024, the sun behind a camera 7 m off."""
    patch_px: Annotated[int, Field(gt=0)] = 5
    """Side of a square patch of coarse pixels, about a tenth of a metre: a detail that is out of place is
    small."""
    most_in_patch: Annotated[int, Field(gt=0)] = 6
    """Contrary pixels of the fullest patch. Right poses had up to 5. Of 25 pixels, each contrary in one case
    of 50, more than six are in one of a million."""
