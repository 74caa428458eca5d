"""Configuration of the estimator: sensors, their methods, navigator, filter."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from rpod_schemas.bounds import SCAN_DIRECTIONS, SIGMA_RANGE_M, AzimuthsRad, ElevationsRad, bounded
from rpod_schemas.config.base import ZENOH_ID, Config, Name, NonNegative, Positive, Share
from rpod_schemas.config.estimator.dynamics import DynamicsConfig
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.config.estimator.integrity import IntegrityConfig
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.lidar.search import GlobalSearchConfig, ProjectiveIcpConfig
from rpod_schemas.config.pmd.depth_calibration import CalibrationSource
from rpod_schemas.config.pmd.joint import JointConfig
from rpod_schemas.config.pmd.search import PmdAcquisitionConfig
from rpod_schemas.config.sensor import DISTINCT, AlertLimit, EmulatedSensor, MethodConfig, SensorInput
from rpod_schemas.config.service import ESTIMATOR_ID, ServiceConfig
from rpod_schemas.config.tuning import BUDGET, BY_HAND, Provenance, Tuning
from rpod_schemas.poses import Pose
from rpod_schemas.sensors.fields import HEARD, chosen
from rpod_schemas.types import Camera, LidarInfo

LidarAcquisition = Annotated[MethodConfig, chosen("lidar", "acquisition")]
"""Method that finds the target in LIDAR scans; ``kind`` chooses among the installed methods."""
LidarTracking = Annotated[MethodConfig, chosen("lidar", "tracking")]
"""Method that tracks the target in LIDAR scans; ``kind`` chooses among the installed methods."""
PmdAcquisition = Annotated[MethodConfig, chosen("pmd", "acquisition", default="view_search")]
"""Method that finds the target in PMD frames; ``kind`` chooses among the installed methods."""
PmdTracking = Annotated[MethodConfig, chosen("pmd", "tracking")]
"""Method that tracks the target in PMD frames; ``kind`` chooses among the installed methods."""


class LidarInput(SensorInput):
    """A LIDAR and the methods for it."""

    kind: str = "lidar"
    """Selects a LIDAR's messages and methods."""
    name: Name = "lidar"
    """Name of the sensor, the first part of its topics. Set it if the driver publishes under another name."""
    azimuth_rad: AzimuthsRad | None = None
    """Azimuths of the scan's columns, rad, shape (columns,). Set them if the driver sends no
    ``<lidar>/info``. If left out, they are inferred from the points, which takes scans with returns in
    several rows and columns."""
    elevation_rad: ElevationsRad | None = None
    """Elevations of the scan's rows, rad, shape (rows,). Set them together with ``azimuth_rad``."""
    sigma_range_m: Annotated[float, bounded(SIGMA_RANGE_M)] | None = None
    """Standard deviation of a range, m. Set it if the driver does not state it in ``<lidar>/info``; otherwise
    0.05 m is assumed. If it is too small, right poses are inconsistent with their scans."""
    acquisition: LidarAcquisition = Field(default_factory=GlobalSearchConfig)
    """Method that finds the target without a prior pose; change ``kind`` to compare methods."""
    tracking: LidarTracking = Field(default_factory=ProjectiveIcpConfig)
    """Method that measures the pose from a predicted one; change ``kind`` to compare methods."""

    @property
    def configured_info(self) -> LidarInfo | None:
        """Scan pattern and range noise that the configuration states; None without a pattern."""
        if self.azimuth_rad is None or self.elevation_rad is None:
            return None
        return LidarInfo(
            azimuth_rad=self.azimuth_rad,
            elevation_rad=self.elevation_rad,
            scan_time_s=0.0,
            sigma_range_m=self.sigma_range_m or 0.0,
        )

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
        if self.azimuth_rad is not None and self.elevation_rad is not None:
            SCAN_DIRECTIONS.check(self.azimuth_rad.size * self.elevation_rad.size)
        return self


class PmdInput(SensorInput):
    """A PMD camera and the methods for it."""

    kind: str = "pmd"
    """Selects a PMD camera's messages and methods."""
    name: Name = "pmd"
    """Name of the sensor, the first part of its topics. Set it if the driver publishes under another name."""
    alert_limit: AlertLimit = AlertLimit(attitude_deg=1.0, position_m=0.03)
    """Error beyond which an estimate by this camera is of no use: what a capture at 1 to 12 m tolerates."""
    camera: Camera | None = None
    """Size and intrinsics that the frames must have. Set it to refuse frames of another camera or lens. If
    left out, the intrinsics of every camera_info are accepted."""
    modulation_frequency_hz: tuple[Positive, ...] = ()
    """Modulation frequencies of the camera, Hz. Set them if ``<camera>/info`` does not state them, so that
    distances beyond the unambiguous range are unwrapped. A camera with several frequencies unwraps by
    itself."""
    calibration: CalibrationSource | None = None
    """Error of the distances, which is subtracted in every frame. Set it to the file that ``rpod calibrate
    depth`` wrote, or write its content inline. With it, the bias of the ranges is assumed to be millimetres,
    without it centimetres."""
    unwrapping: Literal["predicted", "none"] = "predicted"
    """Unwrapping of the depth of a camera that measures with one known frequency. ``predicted`` moves the
    depth by whole unambiguous ranges to where the target is predicted; without a prediction every multiple up
    to 15 m is tried. Set ``none`` if the camera's driver unwraps already."""
    acquisition: PmdAcquisition = Field(default_factory=PmdAcquisitionConfig)
    """Method that finds the target without a prior pose; change ``kind`` to compare methods."""
    tracking: PmdTracking = Field(default_factory=JointConfig)
    """Method that measures the pose from a predicted one; change ``kind`` to compare methods."""

    @property
    def range_offset_sigma_m(self) -> float:
        """Standard deviation that the calibration states, else the one that the joint tracker assumes, m."""
        tracking = self.tracking if isinstance(self.tracking, JointConfig) else JointConfig()
        return tracking.tuning.depth.shared_bias_m(self.calibration)


HeardSensor = Annotated[SensorInput, HEARD]
"""A sensor that the estimator listens to; ``kind`` chooses among the installed ones."""


class NavigatorTuning(Tuning):
    """Limits of the state machine."""

    vague_deg: Annotated[Positive, BY_HAND] = 3.0
    """Standard deviation of the predicted attitude, deg, above which a failed prediction is searched
    around."""
    max_contradicted_share: Annotated[
        Share,
        Provenance(
            "campaign",
            "twice 0.12: of no satellite are more right poses doubtful (docs/limits, most_doubted_share)",
        ),
    ] = 0.25
    """Largest share of a sensor's recent frames, about 90, that may not support the tracked pose. Above it
    the track is LOST at once. No track begins above half of this share."""
    most_rivals: Annotated[
        Annotated[int, Field(ge=1)],
        Provenance(
            "physics", "attitudes of a hexagonal prism; so many tracked frames take less than a search"
        ),
    ] = 12
    """Largest number of rivals of an ambiguous first pose that are tracked in parallel; with more, the next
    frame is searched again. A hexagonal prism looks the same in twelve attitudes, a box in four."""
    search_pause_s: Annotated[NonNegative, BUDGET] = 1.0
    """Time between two searches of one sensor that find nothing, s, where there are several sensors. The
    frames of a sensor that is out of range would otherwise delay the others. One sensor is not affected."""
    search_delay_frames: Annotated[
        Annotated[int, Field(ge=0)],
        Provenance("numerics", "0 is a search that takes no time: what a campaign of methods compares"),
    ] = 0
    """Number of frames of the same sensor after which the result of a search is applied, in lockstep,
    campaigns and replay. A live estimator applies it at the first frame after the search has ended."""
    near_search_s: Annotated[
        NonNegative,
        Provenance("physics", "a body whose rate is 15 deg/s off has then left the 45 deg of such a search"),
    ] = 3.0
    """Time after a loss in which only attitudes near the prediction are searched, s; after it all are."""
    rivals_s: Annotated[Positive, BY_HAND] = 15.0
    """Time after which rivals are given up for a new search if none of them is believed, s. Errors of the
    model that favour one of them count no longer than this."""

    @property
    def max_beginning_share(self) -> float:
        """Largest share of frames that do not support the pose with which a track may begin.

        It is half of the share at which a track is lost, so that tracks do not begin and end in turn.
        """
        return 0.5 * self.max_contradicted_share


class NavigatorConfig(Config):
    """Configuration of the navigator's state machine."""

    confirmations: Annotated[int, Field(ge=0)] = 1
    """Number of frames after that of the acquisition that must verify its pose before TRACKING. Raise it if a
    wrong first pose costs more than a later one; 0 tracks from the first accepted pose."""
    silence_timeout_s: Positive = 2.5
    """Time without any frame after which the prediction is published without one, s. The mode may then become
    COASTING or LOST. Set it above the longest regular gap of the slowest sensor."""
    tuning: NavigatorTuning = NavigatorTuning()
    """Limits and numbers of the method that are outside the public interface; change them only to study
    it."""


class EstimatorSettings(Config):
    """Sensors, navigator and filter of the estimator; part of a scenario."""

    sensors: Annotated[tuple[HeardSensor, ...], DISTINCT] = Field(min_length=1)
    """Sensors that the estimator uses, each with the ``kind`` and the name under which it publishes."""
    initial_pose: Pose | None = None
    """Pose T_chaser_target at the first frame. Set it if the pose is known, as in the 2018 paper; no search
    is made then. If left out, the target is searched."""
    surroundings: Path | None = None
    """File of what is known of the sensors' surroundings: range gates, masks, and the backgrounds that ``rpod
    calibrate background`` writes. Set it if other things fill much of the frames."""
    stale_after_s: Positive = 0.2
    """Longest time without a new accepted measurement in which an estimate is valid, s; one and a half
    periods of a slower sensor. After it the mode is COASTING: the prediction is published while it is within
    the alert limit of the sensor that was accepted last. Set it to what your robot tolerates."""
    navigator: NavigatorConfig = NavigatorConfig()
    """Configuration of the navigator's state machine."""
    filter: FilterConfig = Field(default_factory=FilterConfig)
    """The error-state Kalman filter."""
    dynamics: DynamicsConfig = DynamicsConfig()
    """Motion of target and chaser between measurements."""
    integrity: IntegrityConfig = IntegrityConfig()
    """Protection levels and alerts."""


class EstimatorConfig(ServiceConfig, EstimatorSettings):
    """Configuration of the estimator daemon."""

    instance: Name = "estimator"
    """Name on the bus."""
    zenoh_id: str = Field(default=ESTIMATOR_ID, pattern=ZENOH_ID)
    """Zenoh identity of the estimator, from which the router withholds the truth."""
    target: str
    """Name of a shipped target, or the file of your own. Set it to the body in view, for which all methods
    look."""
    prefix: Name = "estimate"
    """First part of the topics of the estimates. Set it where two estimators run side by side."""
    changed_setup: Literal["refuse", "accept"] = "refuse"
    """Treatment of a sensor whose mount, lens or info changes while the target is tracked. ``refuse`` does
    not use its frames until a reset. Set ``accept`` if a driver may correct them in service, and nobody else
    can publish."""
    max_future_s: NonNegative = 0.05
    """Largest time by which a frame's stamp may be in the future, s; frames beyond it are not used. Raise it
    if the clocks of sensor and estimator differ by more."""
