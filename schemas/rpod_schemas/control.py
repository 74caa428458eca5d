"""The control plane: requests and replies of the JSON queries (ICD section 4)."""

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator
from scipy.spatial.transform import RigidTransform

from rpod_schemas.bounds import POSITION_M, Covariance6, Stamp
from rpod_schemas.config.base import Config, NonNegative, Positive
from rpod_schemas.config.driver import Setting
from rpod_schemas.faults import AskedFault
from rpod_schemas.poses import Pose

Delay = Annotated[float, Field(ge=0, le=86_400, allow_inf_nan=False)]
"""A time in seconds, at most a day."""


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
    """Description of the error and its remedy."""


class StatusReply(Config):
    """The status of a service."""

    name: str
    """Name of the service's instance."""
    version: str
    """Version of the software."""
    state: Literal["starting", "ready", "running", "finished", "stopping", "failed"]
    """State of the service."""
    uptime_s: NonNegative
    """Seconds since the process reported its start."""
    counters: dict[str, int]
    """Counters of frames, of rejections by reason, and of messages by topic."""
    configuration: dict[str, Any]
    """Resolved configuration of the service."""
    target_digest: str | None = None
    """Digest of the parameters of the target that the service uses, if it has one."""
    target_content: str | None = None
    """Digest of this target's arrays, which are built once and then read from a cache."""


class StartRequest(Config):
    """Begin a scenario whose time counts from an epoch."""

    epoch_ns: Stamp | None = Field(default=None, gt=0)
    """Epoch of the scenario, ns of UTC since the Unix epoch. By default motion takes its configured one, or
    one as soon as possible, and the emulator the stamp of the next truth."""
    duration_s: Positive | None = None
    """Duration of the scenario; in lockstep no frame has a stamp after its end."""


class ResetRequest(Config):
    """Restart the estimator, without a pose or from a given one."""

    pose: Pose | None = None
    """Pose T_frame_target."""
    frame_id: str = "chaser"
    """Frame of the pose."""
    stamp_ns: Stamp | None = None
    """Stamp of the pose; by default now."""
    covariance: Covariance6 | None = None
    """Covariance of (dp, dtheta), ICD section 1."""
    keep_gid: str | None = Field(default=None, pattern=r"^[0-9a-f]{32}$")
    """A publisher's gid, hexadecimal digits: the topics of its session are used from now on, whoever else
    publishes them. By default the next valid publishers are used."""

    @field_validator("pose")
    @classmethod
    def _pose_is_somewhere(cls, pose: RigidTransform | None) -> RigidTransform | None:
        if pose is not None:
            POSITION_M.check(pose.translation)
        return pose


class SettingsRequest(Config):
    """Write settings to a driver's device; without any, ask for all."""

    settings: dict[str, Setting] = Field(default_factory=dict)
    """Settings to write, by name."""


class SettingsReply(Config):
    """The settings of a driver's device."""

    settings: dict[str, Setting]
    """All settings with their values in the device now."""


class LogRequest(Config):
    """Start, stop or split a log."""

    name: str | None = Field(default=None, pattern=r"^[A-Za-z0-9._-]+$", max_length=200)
    """Stem of the file's name; file systems take names of 255 bytes, with the number and the suffix."""


class LogReply(Config):
    """The log that is, or was, written."""

    path: str
    """Path of the file."""
    messages: int
    """Number of messages written to it."""
    bytes: int
    """Bytes of payload written to it."""


class FaultRequest(AskedFault):
    """Inject a fault for a while.

    The emulator injects those of sensors, the proxy those of links, the supervisor of a run those of
    processes, the logger that of its disk.
    """

    start_s: Delay = 0.0
    """Start of the fault, seconds from now."""
    duration_s: Delay
    """Duration of the fault."""
