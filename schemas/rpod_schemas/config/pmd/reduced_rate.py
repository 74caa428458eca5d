"""A second stream of a camera for a slow link: fewer frames, each complete, compressed without loss."""

from typing import Literal

from pydantic import Field

from rpod_schemas.config.base import Config, Positive


class ReducedRateConfig(Config):
    """The stream beside the full one; an estimator beyond the slow link listens to it by its ``source``."""

    prefix: str = Field(default="slow", pattern=r"^[A-Za-z][A-Za-z0-9_]*$")
    """First part of its topics: ``slow/<camera>/depth/compressed``, ``slow/<camera>/camera_info``,
    ``slow/<camera>/amplitude/compressed``."""
    mbit_s: Positive
    """Largest number of megabits a second that it needs, on average over its frames. Leave a fifth of the
    link to other messages and to TCP."""
    amplitude: bool = True
    """Whether it carries the amplitude; without it a frame is a third to a half smaller."""
    codec: Literal["shuffle zstd", "none"] = "shuffle zstd"
    """Codec of its images (ICD section 2). With ``none`` its topics end in ``image_raw``."""
