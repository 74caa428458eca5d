"""The estimator's configuration: sensors, their methods, navigator, filter."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from rpod_schemas.arrays import VectorN
from rpod_schemas.config.base import Config, Name, NonNegative, Positive, Share
from rpod_schemas.config.depth_calibration import CalibrationSource
from rpod_schemas.config.filter import FilterConfig
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.lidar_search import GlobalSearchConfig, ProjectiveIcpConfig
from rpod_schemas.config.pmd_joint import JointConfig
from rpod_schemas.config.pmd_search import PmdAcquisitionConfig
from rpod_schemas.config.sensor import EmulatedSensor, MethodConfig, SensorInput
from rpod_schemas.config.service import ESTIMATOR_ID, ServiceConfig
from rpod_schemas.config.tuning import BY_HAND, Tuning
from rpod_schemas.poses import Pose
from rpod_schemas.sensors.fields import HEARD, chosen
from rpod_schemas.types import Camera

LidarAcquisition = Annotated[MethodConfig, chosen("lidar", "acquisition")]
"""How a LIDAR's target is found; ``kind`` chooses among the installed methods."""
LidarTracking = Annotated[MethodConfig, chosen("lidar", "tracking")]
"""How a LIDAR's target is tracked; ``kind`` chooses among the installed methods."""
PmdAcquisition = Annotated[MethodConfig, chosen("pmd", "acquisition", default="view_search")]
"""How a PMD camera's target is found; ``kind`` chooses among the installed methods."""
PmdTracking = Annotated[MethodConfig, chosen("pmd", "tracking")]
"""How a PMD camera's target is tracked; ``kind`` chooses among the installed methods."""


class LidarInput(SensorInput):
    """A LIDAR and the methods for it."""

    kind: str = "lidar"
    """Selects a LIDAR's messages and methods."""
    name: Name = "lidar"
    """Name of the sensor, the first part of its topics. Set it where the driver publishes under another
    one."""
    azimuth_rad: VectorN | None = None
    """Azimuths of the scan's columns. Set them where the driver sends no ``<lidar>/info``; without either no
    scan is used."""
    elevation_rad: VectorN | None = None
    """Elevations of the scan's rows; they are set together with ``azimuth_rad``."""
    sigma_range_m: NonNegative | None = None
    """Standard deviation of a range. Set it where ``<lidar>/info`` does not tell it, else 0.05 m is
    assumed: one that is too small makes right poses contradict their scans."""
    acquisition: LidarAcquisition = Field(default_factory=GlobalSearchConfig)
    """Method that finds the target without a prior pose; change ``kind`` to compare methods."""
    tracking: LidarTracking = Field(default_factory=ProjectiveIcpConfig)
    """Method that measures the pose from a predicted one; change ``kind`` to compare methods."""

    def informed_by(self, emulated: EmulatedSensor) -> Self:
        """Return this input with the scan pattern and the range noise of the emulated LIDAR."""
        if not isinstance(emulated, LidarConfig):
            return self
        info = emulated.info()
        said = {name: getattr(info, name) for name in ("azimuth_rad", "elevation_rad", "sigma_range_m")}
        return self.model_copy(update=said)

    @model_validator(mode="after")
    def _the_pattern_is_whole(self) -> Self:
        if (self.azimuth_rad is None) != (self.elevation_rad is None):
            raise ValueError(
                "azimuth_rad and elevation_rad make the scan pattern together: give both or none"
            )
        return self


class PmdInput(SensorInput):
    """A PMD camera and the methods for it."""

    kind: str = "pmd"
    """Selects a PMD camera's messages and methods."""
    name: Name = "pmd"
    """Name of the sensor, the first part of its topics. Set it where the driver publishes under another
    one."""
    camera: Camera | None = None
    """Size and intrinsics that the frames must have. Set it to refuse frames of another camera or lens; left
    out, camera_info is believed whatever it says."""
    modulation_frequency_hz: tuple[Positive, ...] = ()
    """Modulation frequencies of the camera. Set them where ``<camera>/info`` does not tell, so that distances
    beyond the unambiguous range are unwrapped; a camera with several unwraps by itself."""
    calibration: CalibrationSource | None = None
    """Error of the distances, which is taken off every frame. Set it to the file that ``rpod calibrate``
    wrote, or write its content inline; with it the ranges' bias is trusted to millimetres instead of
    centimetres."""
    unwrapping: Literal["predicted", "none"] = "predicted"
    """Whether depth is moved by whole unambiguous ranges to where the target is predicted, where the camera
    measures with one frequency and it is known; without a prediction every multiple up to 15 m is tried. Set
    ``none`` where the camera's driver unwraps already."""
    acquisition: PmdAcquisition = Field(default_factory=PmdAcquisitionConfig)
    """Method that finds the target without a prior pose; change ``kind`` to compare methods."""
    tracking: PmdTracking = Field(default_factory=JointConfig)
    """Method that measures the pose from a predicted one; change ``kind`` to compare methods."""


HeardSensor = Annotated[SensorInput, HEARD]
"""A sensor that the estimator listens to; ``kind`` chooses among the installed ones."""


class NavigatorTuning(Tuning):
    """Limits of the state machine."""

    vague_deg: Annotated[Positive, BY_HAND] = 3.0
    """A prediction whose attitude has a larger sigma than this is searched around where it does not do."""
    max_contradicted_share: Annotated[Share, BY_HAND] = 0.25
    """Greatest share of a sensor's last 90 frames or so that may not support the tracked pose; beyond it the
    track is LOST at once. A hypothesis becomes a track below half of this share."""


class NavigatorConfig(Config):
    """The state machine."""

    confirmations: Annotated[int, Field(ge=0)] = 1
    """Frames after the acquisition's own that must verify it before TRACKING. Raise it where a wrong first
    pose costs more than a later one; 0 tracks from the first pose that is believed."""
    rejection_timeout_s: Positive = 1.5
    """How long measurements may be rejected before the track is LOST. Raise it for targets that are hidden or
    blinded for seconds; the output is a prediction that long."""
    rejected_frames: Annotated[int, Field(ge=1)] = 3
    """Rejections in a row that LOST needs besides. Raise it for a sensor that delivers less than one frame in
    ``rejection_timeout_s`` / 3, so that one bad frame does not end a track."""
    silence_timeout_s: Positive = 2.5
    """How long no measurement may come before the track is LOST. Set it above the longest regular gap of the
    slowest sensor."""
    near_search_s: NonNegative = 3.0
    """How long after a loss the attitudes near the prediction are searched before all are. Lower it for
    targets that tumble fast, whose prediction is worth little soon."""
    tuning: NavigatorTuning = NavigatorTuning()
    """Limits and numbers that are no part of the promise; change them only to study the method."""


class EstimatorSettings(Config):
    """How poses are estimated; part of a scenario."""

    sensors: tuple[HeardSensor, ...] = Field(min_length=1)
    """What the estimator listens to; each by the ``kind`` and name under which it publishes."""
    initial_pose: Pose | None = None
    """T_chaser_target at the first frame. Set it where the pose is known, as in the 2018 paper: the search is
    left out; left out, the target is searched."""
    navigator: NavigatorConfig = NavigatorConfig()
    """The state machine."""
    filter: FilterConfig = Field(default_factory=FilterConfig)
    """The error-state Kalman filter."""

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        names = [sensor.name for sensor in self.sensors]
        if len(set(names)) < len(names):
            raise ValueError("two sensors have the same name")
        return self


class EstimatorConfig(ServiceConfig, EstimatorSettings):
    """The estimator daemon."""

    instance: Name = "estimator"
    """Name on the bus."""
    zenoh_id: str = Field(default=ESTIMATOR_ID, pattern=r"^[0-9a-f]{1,32}$")
    """Identity that the router keeps from the truth."""
    target: str
    """Name of a shipped target, or the file of your own; all methods look for this body."""
    prefix: Name = "estimate"
    """First part of the topics of the estimates. Set it where two estimators run side by side."""
    max_age_s: Positive = 1.0
    """Frames older than this on arrival are late and not used. Raise it for slow links or long exposures; the
    estimates then lag as much."""
    max_future_s: NonNegative = 0.05
    """Frames that are stamped further ahead than this are from the future and not used. Raise it where the
    clocks of sensor and estimator differ by more."""
