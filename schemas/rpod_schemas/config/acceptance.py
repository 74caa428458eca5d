"""Limits by which methods without a model of their sensor accept a registration by its residuals."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from rpod_schemas.config.base import Config, Positive, Share


class AcceptanceConfig(Config):
    """Limits of cost, inliers and self-check."""

    max_cost_m2: Positive | None = None
    """Largest mean squared residual of the inliers, f_MAX, m2. If left out, it follows: 0.003 m2 for the 2015
    paper's LIDAR (section 4.5), and otherwise in proportion to the square of the range error; 0.003 m2 for a
    camera and the mock-up, and otherwise in proportion to the square of the size of what is seen."""
    min_explained_share: Share
    """Least share of rays or pixels on which model and measurement agree, for a track to begin."""
    min_tracked_share: Share | None = None
    """Least such share for a running track, whose prediction supports the pose as well;
    ``min_explained_share`` if left out."""
    min_inlier_share: Share = 0.3
    """Least share of inliers among the points that could have matched."""
    min_inliers: Annotated[int, Field(ge=6)] = 12
    """Least number of inliers."""

    @property
    def least_tracked_share(self) -> float:
        """Least explained share for a running track."""
        return self.min_explained_share if self.min_tracked_share is None else self.min_tracked_share

    @model_validator(mode="after")
    def _tracking_asks_no_more(self) -> Self:
        if self.min_tracked_share is not None and self.min_tracked_share > self.min_explained_share:
            raise ValueError(
                f"min_tracked_share is {self.min_tracked_share:g}, needs to be at most min_explained_share "
                f"({self.min_explained_share:g}): a running track needs no more than an acquisition"
            )
        return self
