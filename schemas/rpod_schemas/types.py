"""The domain types that services work with after a message has been checked.

Arrays are views of the received bytes if the layout allows it, so that they may be read-only. Stamps are
nanoseconds of UTC since the Unix epoch (ICD section 1).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, PlainValidator, field_validator, model_validator

from rpod_schemas.arrays import Matrix6, Vector3, VectorN
from rpod_schemas.bounds import (
    ACCELERATION_M_S2,
    DISTORTION,
    ELECTRONS_PER_COUNT,
    FOCAL_LENGTH_PX,
    FREQUENCIES,
    IMAGE_PIXELS,
    IMAGE_SIDE,
    INTEGRATION_TIME_S,
    MODULATION_FREQUENCY_HZ,
    PRINCIPAL_POINT_PX,
    RATE_RAD_S,
    SATURATION_COUNT,
    SCAN_DIRECTIONS,
    SCAN_TIME_S,
    SIGMA_RANGE_M,
    VARIANCE,
    AzimuthsRad,
    ElevationsRad,
    Stamp,
    Text,
    bounded,
)
from rpod_schemas.poses import Attitude, Pose

Float32Array = NDArray[np.float32]
SYNC = "sync/"
"""First part of the values of diagnostics that tell how sensors keep time."""
ZERO_6X6 = np.zeros((6, 6))
LENS_COEFFICIENTS = 8
"""Number of distortion coefficients of a rational_polynomial lens; plumb_bob has the first five."""


def _as_float32(value: Any) -> Float32Array:
    if not isinstance(value, np.ndarray) or value.dtype != np.float32:
        raise ValueError("needs a float32 array")
    return value


def _as_image(value: Any) -> NDArray[Any]:
    if not isinstance(value, np.ndarray) or value.ndim != 2:
        raise ValueError("needs a two-dimensional array")
    return value


Floats = Annotated[Float32Array, PlainValidator(_as_float32)]
Image = Annotated[NDArray[Any], PlainValidator(_as_image)]


class Model(BaseModel):
    """Base of the domain types: frozen, closed to unknown fields, with numpy fields."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)


class Stamped(Model):
    """Something measured or estimated at a time, in a frame."""

    stamp_ns: Stamp
    frame_id: Text


class Camera(Model):
    """Pinhole intrinsics and a lens that distorts; pixel centres at integers (ICD section 1)."""

    width: Annotated[int, bounded(IMAGE_SIDE)]
    height: Annotated[int, bounded(IMAGE_SIDE)]
    fx: Annotated[float, bounded(FOCAL_LENGTH_PX)]
    fy: Annotated[float, bounded(FOCAL_LENGTH_PX)]
    cx: Annotated[float, bounded(PRINCIPAL_POINT_PX)]
    cy: Annotated[float, bounded(PRINCIPAL_POINT_PX)]
    distortion: Annotated[VectorN, bounded(DISTORTION)] = Field(default_factory=lambda: np.zeros(5))
    """Distortion coefficients k1, k2, p1, p2, k3 of plumb_bob, shape (5,), or these and k4, k5, k6 of
    rational_polynomial, shape (8,)."""

    @model_validator(mode="after")
    def _fits_into_memory(self) -> Self:
        try:
            IMAGE_PIXELS.check(self.width * self.height)
        except ValueError as error:
            raise ValueError(f"width x height {error}") from error
        return self

    @property
    def coefficients(self) -> NDArray[np.float64]:
        """Distortion coefficients k1, k2, p1, p2, k3, k4, k5, k6, shape (8,)."""
        return np.append(self.distortion, np.zeros(LENS_COEFFICIENTS))[:LENS_COEFFICIENTS]

    @property
    def K(self) -> NDArray[np.float64]:  # noqa: N802 - the camera matrix's name
        """Camera matrix, shape (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


class PmdInfo(Model):
    """Info of a PMD camera (PmdInfo.msg)."""

    modulation_frequency_hz: Annotated[VectorN, bounded(MODULATION_FREQUENCY_HZ)]
    """Modulation frequencies in the order of the phase images, Hz; empty if the camera does not state
    them."""
    integration_time_s: Annotated[float, bounded(INTEGRATION_TIME_S)]
    electrons_per_count: Annotated[float, bounded(ELECTRONS_PER_COUNT)]
    saturation_count: Annotated[float, bounded(SATURATION_COUNT)]

    @field_validator("modulation_frequency_hz")
    @classmethod
    def _frequencies_are_few(cls, value: NDArray[np.float64]) -> NDArray[np.float64]:
        try:
            FREQUENCIES.check(value.size)
        except ValueError as error:
            raise ValueError(f"number {error}") from error
        return value


@dataclass(frozen=True, eq=False)
class FrameImage:
    """An image of a frame, for reports and views."""

    title: str
    """Title, as ``depth``."""
    values: NDArray[Any]
    """Pixels, shape (height, width); NaN for pixels without a value."""
    scale: Literal["depth", "grey"]
    """Unit of the pixels: metres along the boresight, or brightness in any unit."""


class SensorFrame(Stamped):
    """One frame of a sensor of any kind; a kind adds its data, and their images and points for display."""

    @property
    def lens(self) -> Camera | None:
        """Camera that made the frame; None if no camera did."""
        return None

    @property
    def images(self) -> tuple[FrameImage, ...]:
        """Images for reports and views, the most informative first."""
        return ()

    @property
    def returns_m(self) -> Float32Array:
        """Points for display, sensor axes, shape (N, 3), m."""
        return np.zeros((0, 3), np.float32)


class PmdFrame(SensorFrame):
    """One exposure of a PMD camera; ``frame_id`` is the optical frame."""

    depth_m: Floats
    """z-depth, m, shape (height, width); NaN for pixels without depth."""
    amplitude: Image | None
    """Received amplitude, shape (height, width), uint8, uint16 or float32; None if it was not sent."""
    camera: Camera
    info: PmdInfo | None = None
    """Info of the camera; None if it sends none."""
    saturated: Image | None = None
    """Pixels whose amplitude is saturated, so that it is at least what the image says and their depth is NaN,
    bool, shape (height, width); None if there are none."""
    depth_sigma_m: Image | None = None
    """Standard deviation of each pixel's depth as the camera states it, m, float32, shape (height, width);
    None if it states none."""
    hidden: Image | None = None
    """Pixels that tell nothing of the target, because a known body is there, bool, shape (height, width);
    None if no body is known."""

    @property
    def lens(self) -> Camera:
        """Camera that made the frame."""
        return self.camera

    @property
    def images(self) -> tuple[FrameImage, ...]:
        """Images of depth, and of amplitude if it was sent."""
        depth = FrameImage("depth", self.depth_m, "depth")
        return (
            (depth,) if self.amplitude is None else (depth, FrameImage("amplitude", self.amplitude, "grey"))
        )

    @model_validator(mode="after")
    def _sizes_agree(self) -> Self:
        size = (self.camera.height, self.camera.width)
        if self.depth_m.shape != size:
            raise ValueError(f"depth image is {self.depth_m.shape}, camera_info says {size}")
        for name, image in (
            ("amplitude", self.amplitude),
            ("saturation", self.saturated),
            ("depth sigma", self.depth_sigma_m),
            ("hidden", self.hidden),
        ):
            if image is not None and image.shape != size:
                raise ValueError(f"{name} image is {image.shape}, camera_info says {size}")
        return self


class LidarScan(SensorFrame):
    """One scan of a LIDAR."""

    points_m: Floats
    """Points, m, shape (rows, columns, 3) if organised, else (N, 3); NaN for rays without a return."""
    intensity: Floats | None = None
    """Intensities, shape of ``points_m`` without its last axis."""
    time_s: Floats | None = None
    """Times from the stamp, s, shape of ``points_m`` without its last axis."""
    hidden: Image | None = None
    """Rays of the scan pattern that tell nothing of the target, because a known body is there, bool, shape
    (rows, columns); None if no body is known."""

    @model_validator(mode="after")
    def _shapes_agree(self) -> Self:
        shape = self.points_m.shape
        if len(shape) not in (2, 3) or shape[-1] != 3:
            raise ValueError(f"points have shape {shape}, need (rows, columns, 3) or (N, 3)")
        for name in ("intensity", "time_s"):
            array = getattr(self, name)
            if array is not None and array.shape != shape[:-1]:
                raise ValueError(f"{name} has shape {array.shape}, need {shape[:-1]}")
        return self

    @property
    def organised(self) -> bool:
        """Whether rows and columns of the scan pattern are kept."""
        return self.points_m.ndim == 3

    @property
    def returns_m(self) -> Float32Array:
        """Points that are returns, m, shape (N, 3): finite, and not the origin, which means no return."""
        points = self.points_m.reshape(-1, 3)
        return points[np.isfinite(points).all(axis=1) & points.any(axis=1)]


class Joints(Model):
    """Angles of the target's joints, by name."""

    stamp_ns: int
    angle_rad: dict[str, float]
    rate_rad_s: dict[str, float]


class ImuReading(Stamped):
    """Measurement of the chaser's IMU, chaser axes; None for a quantity that it does not measure."""

    rate_rad_s: Annotated[Vector3, bounded(RATE_RAD_S)]
    """Rate relative to inertial space, shape (3,)."""
    rate_variance: Annotated[float, bounded(VARIANCE)] = 0.0
    """Mean variance of the rate about the three axes, (rad/s)^2; 0 if it is not stated."""
    force_m_s2: Annotated[Vector3, bounded(ACCELERATION_M_S2)] | None = None
    """Specific force: acceleration without that of gravity, shape (3,)."""
    R_orbit_chaser: Attitude | None = None
    """Attitude in the orbital frame (ICD section 1)."""
    attitude_variance: Annotated[float, bounded(VARIANCE)] = 0.0
    """Mean variance of the attitude about the three axes, rad2; 0 if it is not stated."""


class LidarInfo(Model):
    """Info of a LIDAR (LidarInfo.msg)."""

    azimuth_rad: AzimuthsRad
    """Azimuths of the scan pattern, rad; directions are (sin az cos el, sin el, cos az cos el)."""
    elevation_rad: ElevationsRad
    scan_time_s: Annotated[float, bounded(SCAN_TIME_S)]
    rows_are_elevation: bool = True
    sigma_range_m: Annotated[float, bounded(SIGMA_RANGE_M)]

    @model_validator(mode="after")
    def _directions_fit_into_memory(self) -> Self:
        try:
            SCAN_DIRECTIONS.check(self.azimuth_rad.size * self.elevation_rad.size)
        except ValueError as error:
            raise ValueError(f"number of azimuth_rad x elevation_rad {error}") from error
        return self


class Odometry(Stamped):
    """Pose and twist of ``child_frame_id`` in ``frame_id`` (ICD section 1)."""

    child_frame_id: Text
    pose: Pose
    """T_frame_child."""
    linear_m_s: Vector3
    """Velocity of the child's origin, R^T dp/dt, child axes, m/s."""
    angular_rad_s: Vector3
    """Rotation rate, vee(R^T dR/dt), child axes, rad/s."""
    pose_covariance: Matrix6 = Field(default_factory=lambda: ZERO_6X6)
    """Covariance of (dp, dtheta) in the fixed axes of ``frame_id``: m2, m rad, rad2."""
    twist_covariance: Matrix6 = Field(default_factory=lambda: ZERO_6X6)
    """Covariance of (linear, angular) in child axes."""


class Mode(IntEnum):
    """State of the navigator (EstimatorStatus.msg)."""

    ACQUIRING = 0
    VERIFYING = 1
    TRACKING = 2
    LOST = 3
    COASTING = 4
    """No measurement supports the track, and its prediction is within the alert limit."""

    @property
    def has_track(self) -> bool:
        """Whether the pose is published: by measurements, or predicted."""
        return self in (Mode.TRACKING, Mode.COASTING)


class Source(IntEnum):
    """Source of the measured pose (EstimatorStatus.msg)."""

    NONE = 0
    LIDAR = 1
    PMD_DEPTH = 2
    PMD_AMPLITUDE = 3
    PMD_JOINT = 4
    OTHER = 255
    """Source of another package's method; the status names the sensor."""


class BeliefLevel(IntEnum):
    """Level of belief in a measured pose (EstimatorStatus.msg)."""

    ACCEPTED = 0
    """The measurement supports the pose."""
    DOUBTFUL = 1
    """The measurement supports the pose weakly, or supports several poses equally."""
    CONTRADICTED = 2
    """The measurement is inconsistent with the pose."""


class Hypothesis(Model):
    """One of several poses that explain a measurement."""

    pose: Pose
    """T_chaser_target."""
    weight: Annotated[float, Field(ge=0, le=1)]
    name: str = ""
    """Difference from the first: "symmetry of the target", "turned by 180 deg"; empty for the first."""
    log_likelihood: float = float("nan")
    """Log likelihood of the measurement at this pose minus that at the first one."""


class EstimatorStatus(Stamped):
    """Result of the estimator for one frame (EstimatorStatus.msg)."""

    mode: Mode
    source: Source = Source.NONE
    sensor: Text = ""
    accepted: bool = False
    reason: Text = ""
    """Reason for which the measurement was rejected; empty if it was accepted."""
    cost_m2: float = float("nan")
    """Mean squared residual f_CONV, m2."""
    nis: float = float("nan")
    inliers: Annotated[int, Field(ge=0)] = 0
    inlier_share: float = float("nan")
    processing_s: float = float("nan")
    """Time from the arrival of the frame's last part to publication, s."""
    ambiguous: bool = False
    hypotheses: tuple[Hypothesis, ...] = ()
    """Hypotheses, best first; their weights sum to 1."""
    belief: BeliefLevel = BeliefLevel.ACCEPTED
    """Belief of the method in its pose, which the filter's gate may still reject."""
    evidence: dict[str, float] = Field(default_factory=dict)
    """Numbers from which the belief follows, by name; each name carries its unit or is a share."""


class EstimateValidity(Stamped):
    """Whether the newest estimate may be used now (EstimateValidity.msg)."""

    valid: bool
    age_s: float
    """Age of the newest measurement that the estimate holds, s; NaN if there is none."""
    reason: Text
    """Reason why the estimate is not valid; empty if it is."""


class IntegrityState(IntEnum):
    """Whether the estimate may be used within its protection levels (Integrity.msg)."""

    UNAVAILABLE = 0
    """There is no estimate, or a protection level is above its alert limit."""
    NOMINAL = 1
    """All tests of the estimate pass, and both levels are below their alert limits."""
    CAUTION = 2
    """The same, but the newest measurement was not accepted, or a test is close to its limit."""
    ALERT = 3
    """A test failed: do not use the estimate, whatever its levels are."""

    @property
    def is_usable(self) -> bool:
        """Whether the estimate may be used within its levels."""
        return self in (IntegrityState.NOMINAL, IntegrityState.CAUTION)


class Integrity(Stamped):
    """Bounds of the errors that the estimate may have without an alert (Integrity.msg).

    The level is the length of error that is exceeded without an alert with at most the probability ``risk``.
    """

    state: IntegrityState
    reason: Text = ""
    """Reason for any state but nominal, with figures."""
    risk: Annotated[float, Field(gt=0, lt=1)]
    """Probability for each estimate that one of the errors is above its level without an alert."""
    attitude_level_deg: float = float("nan")
    """Protection level of the attitude, deg; NaN without an estimate."""
    position_level_m: float = float("nan")
    """Protection level of the position, m; NaN without an estimate."""
    attitude_limit_deg: float = float("nan")
    """Alert limit of the attitude, deg."""
    position_limit_m: float = float("nan")
    """Alert limit of the position at this range, m; NaN without an estimate."""
    evidence: dict[str, float] = Field(default_factory=dict)
    """Numbers from which state and levels follow, by name; each name carries its unit or is a share."""


class SensorSync(Model):
    """How a sensor keeps time, as its driver knows it; None for what is not known."""

    ptp: Literal["locked", "unlocked", "none"] | None = None
    """Whether the sensor's clock is locked to a PTP master."""
    ptp_offset_s: float | None = None
    """Offset from the PTP master, s."""
    trigger: Literal["hardware", "software", "none"] | None = None
    """Source of the trigger of each frame."""
    trigger_missed: Annotated[int, Field(ge=0)] | None = None
    """Number of triggers without a frame."""
    stamp_source: Literal["device", "mapped", "host"] | None = None
    """Clock that stamps the frames: the device's own, this clock mapped to the host's by the least delay, or
    the host's at the arrival of the frame."""

    def values(self, sensor: str) -> dict[str, str]:
        """Return what is known as values of diagnostics (ICD section 2)."""
        known = self.model_dump(exclude_none=True)
        return {f"{SYNC}{sensor}/{name}": f"{value}" for name, value in known.items()}

    @classmethod
    def read(cls, sensor: str, values: Mapping[str, str]) -> "SensorSync | None":
        """Return what diagnostics tell of a sensor; None if that is nothing.

        Raises:
            pydantic.ValidationError: a value is not one of those of the ICD.
        """
        prefix = f"{SYNC}{sensor}/"
        told = {name: value for key, value in values.items() if (name := key.removeprefix(prefix)) != key}
        return (
            cls.model_validate({name: told[name] for name in cls.model_fields if name in told})
            if told
            else None
        )


class Health(IntEnum):
    """Level of a diagnostic (diagnostic_msgs/DiagnosticStatus)."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


PUBLISHED = "published/"
"""Beginning of the names of counters in a diagnostic: messages that the service published, by topic."""
CLOSING = "closing"
"""Name of the value that is ``true`` in the last diagnostic of a service: it publishes nothing after it."""


class Diagnostic(Model):
    """Health of one service; also its heartbeat."""

    stamp_ns: Stamp
    name: Text
    """Name of the service's instance."""
    level: Health
    message: Text
    values: dict[str, str]
