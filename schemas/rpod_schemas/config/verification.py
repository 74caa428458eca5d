"""When a registration is believed."""

from typing import Annotated, Literal

from pydantic import Field

from rpod_schemas.config.base import Config, Positive, Share


class VerificationConfig(Config):
    """When a registration is believed."""

    max_cost_m2: Positive
    """f_MAX: f_CONV above this is a failure (2015 paper, section 4.5)."""
    min_explained_share: Share
    """Least share of rays or pixels on which model and measurement agree; not asked where it is not known."""
    min_inlier_share: Share = 0.3
    """Least share of inliers among the points that could have matched."""
    candidates: Annotated[int, Field(ge=1)] = 3
    """Most candidates of a search that are refined and verified."""
    choice: Literal["first", "best_explained"] = "first"
    """Of the believed candidates: the first in the search's own order, or the one that explains most."""
    min_inliers: Annotated[int, Field(ge=6)] = 12
    """Least number of inliers."""
