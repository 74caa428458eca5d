"""When a registration is believed."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from rpod_schemas.config.base import Config, Positive, Share


class VerificationConfig(Config):
    """When a registration is believed."""

    max_cost_m2: Positive
    """f_MAX: f_CONV above this is a failure (2015 paper, section 4.5)."""
    min_explained_share: Share
    """Least share of rays or pixels on which model and measurement agree; not asked where it is not known."""
    min_tracked_share: Share | None = None
    """The same while a track goes on, whose prediction speaks for the pose as well; left out: no less."""
    min_inlier_share: Share = 0.3
    """Least share of inliers among the points that could have matched."""
    candidates: Annotated[int, Field(ge=1)] = 3
    """Most candidates of a search that are refined and verified."""
    choice: Literal["first", "best_explained"] = "first"
    """Of the believed candidates: the first in the search's own order, or the one that explains most."""
    min_inliers: Annotated[int, Field(ge=6)] = 12
    """Least number of inliers."""
    max_sigma_m: Positive | None = None
    """Greatest standard deviation of the position in its worst direction: what shows less of the target fits
    much else. Left out, and of a track that goes on, it is not asked."""
    max_sigma_deg: Positive | None = None
    """The same of the attitude."""

    @property
    def while_tracking(self) -> Self:
        """The limits for a track that goes on."""
        least = self.min_explained_share if self.min_tracked_share is None else self.min_tracked_share
        return self.model_copy(
            update={"min_explained_share": least, "max_sigma_m": None, "max_sigma_deg": None}
        )

    @model_validator(mode="after")
    def _tracking_asks_no_more(self) -> Self:
        if self.min_tracked_share is not None and self.min_tracked_share > self.min_explained_share:
            raise ValueError(
                f"min_tracked_share is {self.min_tracked_share:g}, may be min_explained_share "
                f"({self.min_explained_share:g}) at most: a track asks no more than an acquisition"
            )
        return self
