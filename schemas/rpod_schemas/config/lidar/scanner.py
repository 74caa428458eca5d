"""The scanning time-of-flight LIDAR, as Opromolla et al., Sensors 15(3), 2015 describe it in section 3.2.

Defaults are Table 1 of the paper. Values that it does not give are marked as assumed. Where its text has two
readings, an option offers both by name.
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
    """Angle from the first column to the last, deg."""
    elevation_span_deg: Annotated[float, Field(ge=0, lt=180)] = 40.0
    """Angle from the first row to the last, deg."""
    step_deg: Positive = 1.0
    """Angle delta_LOS between neighbouring rays, deg. Both ends of a span are rays, so that 40 deg have 41 at
    1 deg."""

    @model_validator(mode="after")
    def _spans_are_whole_steps(self) -> Self:
        for name in ("azimuth_span_deg", "elevation_span_deg"):
            steps = getattr(self, name) / self.step_deg
            if not np.isclose(steps, np.rint(steps), rtol=0.0, atol=1e-6) or np.isinf(steps):
                raise ValueError(f"{name} is {steps:.3f} times step_deg, needs to be a whole number of steps")
        return self


class LidarTransmitterConfig(Config):
    """The pulsed laser (Table 1)."""

    wavelength_m: Positive = 1540e-9
    """Wavelength lambda, m."""
    average_power_W: Positive = 1e-3
    """Mean power Pw_TRAN, W; over pulse rate and pulse width it is a peak power of 100 W."""
    pulse_width_s: Positive = 1e-9
    """Pulse width tau_W, s; also the time over which the detector integrates."""
    pulse_rate_hz: Positive = 10e3
    """Pulse repetition frequency PRF, Hz; each ray is one pulse."""
    beam_divergence_rad: Positive = radians(0.02)
    """Beam divergence d theta, full angle, rad; also the receiver's field of view (assumed)."""


class LidarReceiverConfig(Config):
    """Optics and InGaAs avalanche photodiode (Table 1)."""

    aperture_m: Positive = 0.025
    """Diameter D of the aperture, m."""
    filter_bandwidth_nm: Positive = 24.0
    """Bandwidth Delta lambda of the band-pass filter, nm."""
    transmittance: Share = 0.3898
    """Transmittance tau_O of the filter."""
    quantum_efficiency: Share = 0.7247
    """Quantum efficiency eta, electrons per photon."""
    gain: Annotated[float, Field(ge=1)] = 10.0
    """Gain G_APD of the avalanche photodiode."""
    capacitance_F: Positive = 1.5e-12
    """Capacitance Ca of the detector's circuit, F."""
    temperature_K: Positive = 273.15
    """Operating temperature Temp, K."""
    dark_current_A: NonNegative = 150e-9
    """Mean dark current i_D, A."""
    sun_irradiance_W_m2_nm: NonNegative = 0.27
    """Spectral irradiance of the sunlit target at the wavelength, W/m2/nm (assumed: ASTM G-173, AM1.5)."""


class LidarDetectionConfig(Config):
    """Readings of the paper's detection model."""

    returned: Literal["detected", "all"] = "detected"
    """Rays that return: detected applies the detection model; all returns every ray that meets the target."""
    false_alarm: Annotated[float, Field(gt=0, lt=1)] = 1e-4
    """Probability P_FA of a false alarm (section 3.2)."""
    threshold: Literal["usual", "printed"] = "usual"
    """Threshold of Eq. 4: printed is 0.5 ln(1/P_FA), usual is sqrt(ln(1/P_FA)). With the printed one, a ray
    that meets nothing is detected less often than P_FA, which indicates a misprint."""
    gain_on_variance: Literal["linear", "squared"] = "linear"
    """Factor on N_b in Eq. 9: linear is G, as in the paper; squared is G^2 F, the variance of an
    avalanche."""
    excess_noise_factor: Annotated[float, Field(ge=1)] = 1.0
    """Excess noise factor F of the avalanche; it has an effect only if gain_on_variance is squared."""
    shot_noise: bool = False
    """Whether to add the signal's own shot noise, which Eq. 9 leaves out."""
    reflectivity: Literal["material", "mean"] = "material"
    """Reflectivity rho_T: that of the material which a ray meets, or mean_reflectivity everywhere."""
    mean_reflectivity: Share = 0.6
    """Mean reflectivity of an aged satellite (section 3.1)."""

    @model_validator(mode="after")
    def _excess_noise_has_an_effect(self) -> Self:
        if self.excess_noise_factor != 1.0 and self.gain_on_variance != "squared":
            raise ValueError("excess_noise_factor has an effect only with gain_on_variance: squared")
        return self


class LidarNoiseConfig(Config):
    """Errors of the detected points (Table 1)."""

    sigma_range_m: NonNegative = 0.025
    """Standard deviation sigma_RANGE of the white range error, m."""
    sigma_pointing_rad: NonNegative = radians(0.0007)
    """Standard deviation sigma_LOS of the angle between commanded and true ray, rad."""
    outlier_share: Share = 0.06
    """Share P_O of the points with a larger sigma, which stand for multipath; 5 to 7 % in Table 1."""
    outlier_factor: Annotated[float, Field(ge=1)] = 4.0
    """Standard deviation of these points over sigma_RANGE."""
    gross_outlier_share: Share = 0.0
    """Share of points whose range carries no information; not in the paper."""
    gross_outlier_m: Positive = 5.0
    """Largest error of a gross outlier, uniform before and behind the true range, m."""


class LidarConfig(EmulatedSensor):
    """A scanning LIDAR: pattern, detection, noise and mount."""

    kind: str = "lidar"
    """Selects this sensor."""
    name: Name = "lidar"
    """Name of the sensor: prefix of its topics, and its frame."""
    rate_hz: Positive = 1.0
    """Number of scans per second (section 4.1)."""
    T_chaser_sensor: Pose = Field(default_factory=make_pose)
    """Mount: pose of the LIDAR in the chaser."""
    readout_s: NonNegative = 0.01
    """Time from the last pulse to the hand-over of the scan, s (assumed)."""
    motion: Literal["instantaneous", "skewed"] = "instantaneous"
    """Motion within a scan. instantaneous: the target stands still during a scan, as in the paper; skewed:
    each row sees it at the row's own time."""
    pattern: ScanPatternConfig = ScanPatternConfig()
    """Directions of the rays."""
    transmitter: LidarTransmitterConfig = LidarTransmitterConfig()
    """The laser."""
    receiver: LidarReceiverConfig = LidarReceiverConfig()
    """Optics and detector."""
    detection: LidarDetectionConfig = LidarDetectionConfig()
    """Detection of the returned rays."""
    noise: LidarNoiseConfig = LidarNoiseConfig()
    """Errors of the detected points."""

    @property
    def azimuth_rad(self) -> FloatArray:
        """Azimuths of the columns, rad, shape (columns,)."""
        return _steps_rad(self.pattern.azimuth_span_deg, self.pattern.step_deg)

    @property
    def elevation_rad(self) -> FloatArray:
        """Elevations of the rows, rad, shape (rows,)."""
        return _steps_rad(self.pattern.elevation_span_deg, self.pattern.step_deg)

    @property
    def scan_time_s(self) -> float:
        """Time from the first pulse to the end of the last one's slot, s."""
        return self.azimuth_rad.size * self.elevation_rad.size / self.transmitter.pulse_rate_hz

    @property
    def latency_s(self) -> float:
        """Time from the stamp, the middle of the scan, to its hand-over, s."""
        return self.scan_time_s / 2.0 + self.readout_s

    def ray_times_s(self) -> FloatArray:
        """Return the times at which the rays are sent, offsets from the stamp, s, shape (rows, columns)."""
        shape = self.elevation_rad.size, self.azimuth_rad.size
        if self.motion == "instantaneous":
            return np.zeros(shape)
        return _centred(shape[0] * shape[1]).reshape(shape) / self.transmitter.pulse_rate_hz

    def pose_times_s(self) -> tuple[float, ...]:
        """Return the times of the needed poses, offsets from the stamp, s: one, or the middle of each row."""
        if self.motion == "instantaneous":
            return (0.0,)
        return tuple(self.ray_times_s().mean(axis=1).tolist())

    def info(self) -> LidarInfo:
        """Return the sensor's description of itself on the bus."""
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
