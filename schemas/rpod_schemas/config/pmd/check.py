"""Limits of the pixels of a PMD frame that may be inconsistent with a pose."""

from typing import Annotated

from pydantic import Field

from rpod_schemas.config.base import Count, NonNegative, Positive, Share
from rpod_schemas.config.tuning import BY_HAND, OF_CAMERA, POPULATION_PMD, Limit, Provenance, Tuning


class PmdCheckConfig(Tuning):
    """Limits for pixels that are inconsistent with a pose, relative to each pixel's own noise."""

    tolerance_share: Annotated[Positive, BY_HAND] = 0.064
    """Error above which a range is inconsistent with the pose, as a share of the target's radius, if it
    exceeds three times its noise and the uneven error of the camera as well."""
    most_noise_m: Annotated[Positive, OF_CAMERA] = 0.1
    """Largest noise of a range that is checked, m, estimated from its neighbours; a noisier range is of the
    dark background, not of a surface."""
    reach_px: Annotated[Positive, BY_HAND] = 2.5
    """Largest tolerated displacement of the model's outlines and edges in the image, px. It covers the width
    of a coarse pixel, mixed pixels and the pose's own error."""
    place_share: Annotated[
        NonNegative,
        Provenance("hand, mock-up", "twice 0.3 % of the size, by which a target may differ from its file"),
    ] = 0.0064
    """Further tolerated displacement on the target, as a share of its radius."""
    most_inconsistent_share: Annotated[
        Share,
        Limit("inconsistent_pixel_share"),
        POPULATION_PMD,
    ] = 0.045
    """Largest share of inconsistent pixels among the checked ones."""
    patch_px: Annotated[int, Field(gt=0), BY_HAND] = 5
    """Side of a square patch, coarse pixels; about a tenth of a metre if no depth is lost, because a
    misplaced detail is small."""
    most_in_patch: Annotated[
        Count,
        Limit("inconsistent_pixels_in_patch"),
        POPULATION_PMD,
    ] = 7
    """Largest number of inconsistent pixels in one patch. If one pixel in 30 is inconsistent, more than seven
    of 25 are so in one patch of a million."""
    most_missing: Annotated[
        Count,
        Limit("missing_pixels_in_patch"),
        POPULATION_PMD,
    ] = 3
    """Largest number of pixels in one patch that lack a predicted surface; at a right pose they are beside
    glints."""
