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
    """Which methods."""
    name: Name = "lidar"
    """Of the sensor: the first part of its topics."""
    azimuth_rad: VectorN | None = None
    """Scan pattern, where the latched info does not tell."""
    elevation_rad: VectorN | None = None
    """Scan pattern, where the latched info does not tell."""
    sigma_range_m: NonNegative | None = None
    """Standard deviation of a range, where the latched info does not tell."""
    acquisition: LidarAcquisition = Field(default_factory=GlobalSearchConfig)
    """Without a prior pose."""
    tracking: LidarTracking = Field(default_factory=ProjectiveIcpConfig)
    """From a predicted pose."""

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
    """Which methods."""
    name: Name = "pmd"
    """Of the sensor: the first part of its topics."""
    camera: Camera | None = None
    """Size and intrinsics that the frames must have; left out, camera_info is believed whatever it says."""
    modulation_frequency_hz: tuple[Positive, ...] = ()
    """Of the camera, where its latched info does not tell; a camera with several unwraps by itself."""
    calibration: CalibrationSource | None = None
    """Error of the distances, taken off every frame: inline, or the file that ``rpod calibrate`` wrote."""
    unwrapping: Literal["predicted", "none"] = "predicted"
    """Whether depth is moved by whole unambiguous ranges to where the target is predicted, where the camera
    measures with one frequency and it is known; without a prediction every multiple up to 15 m is tried."""
    acquisition: PmdAcquisition = Field(default_factory=PmdAcquisitionConfig)
    """Without a prior pose."""
    tracking: PmdTracking = Field(default_factory=JointConfig)
    """From a predicted pose."""


HeardSensor = Annotated[SensorInput, HEARD]
"""A sensor that the estimator listens to; ``kind`` chooses among the installed ones."""


class NavigatorConfig(Config):
    """The state machine."""

    confirmations: Annotated[int, Field(ge=0)] = 1
    """Frames after the acquisition's own that must verify it before TRACKING."""
    vague_deg: Positive = 3.0
    """A prediction whose attitude has a larger sigma than this is searched around where it does not do."""
    rejection_timeout_s: Positive = 1.5
    """Measurements rejected for longer than this: LOST."""
    rejected_frames: Annotated[int, Field(ge=1)] = 3
    """Least number of rejections in a row before LOST, for slow sensors."""
    max_contradicted_share: Share = 0.25
    """Greatest share of a sensor's last 90 frames or so that may not support the tracked pose; beyond it the
    track is LOST at once. A hypothesis becomes a track below half of this share."""
    silence_timeout_s: Positive = 2.5
    """No measurement for longer than this: LOST."""
    near_search_s: NonNegative = 3.0
    """How long after a loss the prediction is tried before a search over everything."""


class EstimatorSettings(Config):
    """How poses are estimated; part of a scenario."""

    sensors: tuple[HeardSensor, ...] = Field(min_length=1)
    """What the estimator listens to."""
    initial_pose: Pose | None = None
    """T_chaser_target at the first frame, where it is given as in the 2018 paper; else it is searched."""
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
    """Name or file of the target."""
    prefix: Name = "estimate"
    """First part of the topics of the estimates, so that two estimators run side by side."""
    max_age_s: Positive = 1.0
    """Frames older than this on arrival are late."""
    max_future_s: NonNegative = 0.05
    """Frames stamped further ahead than this are from the future."""
