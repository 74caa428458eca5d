"""The control plane: requests and replies of the JSON queries (ICD section 4)."""

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator
from scipy.spatial.transform import RigidTransform

from rpod_schemas.bounds import POSITION_M, Covariance6, Stamp
from rpod_schemas.config.base import Config, NonNegative, Positive
from rpod_schemas.poses import Pose

Delay = Annotated[float, Field(ge=0, le=86_400, allow_inf_nan=False)]
"""Seconds, at most a day."""


class Empty(Config):
    """A request without fields."""


class Accepted(Config):
    """The reply to a command."""

    accepted: Literal[True] = True


class ErrorReply(Config):
    """The reply to a query that failed."""

    error: str
    """Class of the error."""
    message: str
    """What is wrong and what to do."""


class StatusReply(Config):
    """What a service says of itself."""

    name: str
    """Instance."""
    version: str
    """Version of the software."""
    state: Literal["starting", "ready", "running", "finished", "stopping", "failed"]
    """Where the service is in its life."""
    uptime_s: NonNegative
    """Seconds since the process said that it was there."""
    counters: dict[str, int]
    """Everything counted: frames, rejections by reason, messages by topic."""
    configuration: dict[str, Any]
    """As resolved."""
    target_digest: str | None = None
    """Of the target that the service works with, where it has one."""


class StartRequest(Config):
    """Begin a scenario whose time counts from an epoch."""

    epoch_ns: Stamp = Field(gt=0)
    """UTC since the Unix epoch."""
    duration_s: Positive | None = None
    """How long the scenario is: in lockstep no frame is made with a stamp beyond its end."""


class ResetRequest(Config):
    """Start the estimator anew, from nothing or from a given pose."""

    pose: Pose | None = None
    """T_frame_target."""
    frame_id: str = "chaser"
    """The frame of the pose."""
    stamp_ns: Stamp | None = None
    """When the pose held; now, where left out."""
    covariance: Covariance6 | None = None
    """Of (dp, dtheta), ICD section 1."""

    @field_validator("pose")
    @classmethod
    def _pose_is_somewhere(cls, pose: RigidTransform | None) -> RigidTransform | None:
        if pose is not None:
            POSITION_M.check(pose.translation)
        return pose


class LogRequest(Config):
    """Start, stop or split a log."""

    name: str | None = Field(default=None, pattern=r"^[A-Za-z0-9._-]+$")
    """Stem of the file's name."""


class LogReply(Config):
    """The log that is, or was, written."""

    path: str
    """Of the file."""
    messages: int
    """Written to it."""
    bytes: int
    """Of payload written to it."""


class FaultRequest(Config):
    """Make the emulated sensors fail for a while."""

    fault: Literal["dropout", "glints", "blackout", "silence"]
    """dropout loses the depth of 60 % of the pixels, or 60 % of the returns, in patches; glints lose depth
    and amplitude of 40 %, blackout of all; silence publishes nothing."""
    start_s: Delay = 0.0
    """From now."""
    duration_s: Delay
    """How long."""
