"""The scanning time-of-flight LIDAR, as Opromolla et al., Sensors 15(3), 2015 describe it in section 3.2.

Defaults are Table 1 of the paper. What it leaves open is marked as assumed, and what it prints in a
way that can be read twice is an option with both readings by name.
"""

from math import radians
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.base import Config, Name, NonNegative, Positive, Share
from rpod_schemas.config.sensor import EmulatedSensor
from rpod_schemas.poses import Pose, make_pose
from rpod_schemas.types import LidarInfo


class ScanPatternConfig(Config):
    """A raster: even steps in azimuth and elevation, centred on the boresight, row by row (section 4.1)."""

    azimuth_span_deg: Annotated[float, Field(ge=0, lt=180)] = 40.0
    """From the first column to the last."""
    elevation_span_deg: Annotated[float, Field(ge=0, lt=180)] = 40.0
    """From the first row to the last."""
    step_deg: Positive = 1.0
    """delta_LOS, between neighbours; both ends of a span are rays, so 40 deg are 41 of them."""

    @model_validator(mode="after")
    def _spans_are_whole_steps(self) -> Self:
        for name in ("azimuth_span_deg", "elevation_span_deg"):
            steps = getattr(self, name) / self.step_deg
            if abs(steps - round(steps)) > 1e-6:
                raise ValueError(f"{name} is {steps:.3f} times step_deg, needs to be a whole number of steps")
        return self


class LidarTransmitterConfig(Config):
    """The pulsed laser (Table 1)."""

    wavelength_m: Positive = 1540e-9
    """lambda."""
    average_power_W: Positive = 1e-3
    """Pw_TRAN; over PRF and pulse width it is a peak power of 100 W."""
    pulse_width_s: Positive = 1e-9
    """tau_W, also the time over which the detector integrates."""
    pulse_rate_hz: Positive = 10e3
    """PRF; one pulse a ray."""
    beam_divergence_rad: Positive = radians(0.02)
    """d theta, full angle; taken as the receiver's field of view too (assumed)."""


class LidarReceiverConfig(Config):
    """Optics and InGaAs avalanche photodiode (Table 1)."""

    aperture_m: Positive = 0.025
    """D, diameter."""
    filter_bandwidth_nm: Positive = 24.0
    """Delta lambda of the band-pass filter."""
    transmittance: Share = 0.3898
    """tau_O of the filter."""
    quantum_efficiency: Share = 0.7247
    """eta, electrons per photon."""
    gain: Annotated[float, Field(ge=1)] = 10.0
    """G_APD of the avalanche photodiode."""
    capacitance_F: Positive = 1.5e-12
    """Ca of the detector's circuit."""
    temperature_K: Positive = 273.15
    """Temp, of operation."""
    dark_current_A: NonNegative = 150e-9
    """i_D, mean."""
    sun_irradiance_W_m2_nm: NonNegative = 0.27
    """Of the sunlit target, at the wavelength (assumed: ASTM G-173, AM1.5)."""


class LidarDetectionConfig(Config):
    """Which reading of the paper's detection model is used."""

    returned: Literal["detected", "all"] = "detected"
    """all switches the model off: every ray that meets the target comes back."""
    false_alarm: Annotated[float, Field(gt=0, lt=1)] = 1e-4
    """P_FA (section 3.2)."""
    threshold: Literal["usual", "printed"] = "usual"
    """Eq. 4's threshold: printed is 0.5 ln(1/P_FA), usual is sqrt(ln(1/P_FA)). As printed a ray that meets
    nothing is detected less often than P_FA says, which speaks for a misprint."""
    gain_on_variance: Literal["linear", "squared"] = "linear"
    """What N_b is multiplied by in Eq. 9: linear is G, as the paper has it; squared is G^2 F, the variance of
    an avalanche."""
    excess_noise_factor: Annotated[float, Field(ge=1)] = 1.0
    """F of the avalanche; counts where gain_on_variance is squared."""
    shot_noise: bool = False
    """Add the signal's own shot noise, which Eq. 9 leaves out."""
    reflectivity: Literal["material", "mean"] = "material"
    """rho_T: of the material that a ray meets, or mean_reflectivity everywhere."""
    mean_reflectivity: Share = 0.6
    """The paper's mean for an aged satellite (section 3.1)."""

    @model_validator(mode="after")
    def _excess_noise_has_an_effect(self) -> Self:
        if self.excess_noise_factor != 1.0 and self.gain_on_variance != "squared":
            raise ValueError("excess_noise_factor counts only with gain_on_variance: squared")
        return self


class LidarNoiseConfig(Config):
    """Errors of the detected points (Table 1)."""

    sigma_range_m: NonNegative = 0.025
    """sigma_RANGE, white."""
    sigma_pointing_rad: NonNegative = radians(0.0007)
    """sigma_LOS, of the angle between commanded and true ray."""
    outlier_share: Share = 0.06
    """P_O, 5 to 7 % in Table 1: points with a larger sigma, which stand for multipath."""
    outlier_factor: Annotated[float, Field(ge=1)] = 4.0
    """Their sigma over sigma_RANGE."""
    gross_outlier_share: Share = 0.0
    """Share of points with a range that says nothing; not in the paper."""
    gross_outlier_m: Positive = 5.0
    """Gross outliers are spread evenly up to this far before and behind the true range."""


class LidarConfig(EmulatedSensor):
    """A scanning LIDAR: pattern, detection, noise and mount."""

    kind: str = "lidar"
    """Selects this sensor."""
    name: Name = "lidar"
    """Prefix of its topics, and its frame."""
    rate_hz: Positive = 1.0
    """Scans per second (section 4.1)."""
    T_chaser_sensor: Pose = Field(default_factory=make_pose)
    """Mount: pose of the LIDAR in the chaser."""
    readout_s: NonNegative = 0.01
    """From the last pulse to the scan's hand-over (assumed)."""
    motion: Literal["instantaneous", "skewed"] = "instantaneous"
    """instantaneous: the target stands still during a scan, as in the paper; skewed: each row sees it at the
    row's own time."""
    pattern: ScanPatternConfig = ScanPatternConfig()
    """Where it looks."""
    transmitter: LidarTransmitterConfig = LidarTransmitterConfig()
    """The laser."""
    receiver: LidarReceiverConfig = LidarReceiverConfig()
    """Optics and detector."""
    detection: LidarDetectionConfig = LidarDetectionConfig()
    """Which rays come back."""
    noise: LidarNoiseConfig = LidarNoiseConfig()
    """Errors of those that do."""

    @property
    def azimuth_rad(self) -> FloatArray:
        """Of the columns, shape (columns,)."""
        return _steps_rad(self.pattern.azimuth_span_deg, self.pattern.step_deg)

    @property
    def elevation_rad(self) -> FloatArray:
        """Of the rows, shape (rows,)."""
        return _steps_rad(self.pattern.elevation_span_deg, self.pattern.step_deg)

    @property
    def scan_time_s(self) -> float:
        """From the first pulse to the end of the last one's slot."""
        return self.azimuth_rad.size * self.elevation_rad.size / self.transmitter.pulse_rate_hz

    @property
    def latency_s(self) -> float:
        """From the stamp, the middle of the scan, to its hand-over."""
        return self.scan_time_s / 2.0 + self.readout_s

    def ray_times_s(self) -> FloatArray:
        """Return when each ray is shot, offsets from the stamp, shape (rows, columns)."""
        shape = self.elevation_rad.size, self.azimuth_rad.size
        if self.motion == "instantaneous":
            return np.zeros(shape)
        return _centred(shape[0] * shape[1]).reshape(shape) / self.transmitter.pulse_rate_hz

    def pose_times_s(self) -> tuple[float, ...]:
        """Return when the pose is needed, offsets from the stamp: once, or in the middle of each row."""
        if self.motion == "instantaneous":
            return (0.0,)
        return tuple(self.ray_times_s().mean(axis=1).tolist())

    def info(self) -> LidarInfo:
        """Return what the sensor says of itself on the bus."""
        return LidarInfo(
            azimuth_rad=self.azimuth_rad,
            elevation_rad=self.elevation_rad,
            scan_time_s=self.scan_time_s if self.motion == "skewed" else 0.0,
            sigma_range_m=self.noise.sigma_range_m,
        )

    @model_validator(mode="after")
    def _scans_do_not_overlap(self) -> Self:
        if self.scan_time_s * self.rate_hz > 1.0 + 1e-9:
            raise ValueError(
                f"rate_hz is {self.rate_hz:g}, but a scan takes {self.scan_time_s:.3g} s at the pulse rate"
            )
        return self


def _steps_rad(span_deg: float, step_deg: float) -> FloatArray:
    return _centred(round(span_deg / step_deg) + 1) * radians(step_deg)


def _centred(count: int) -> FloatArray:
    """Return numbers in steps of one about zero."""
    return np.arange(count, dtype=np.float64) - (count - 1) / 2.0
