"""The PMD camera: DLR-Argos 3D-P320, as Klionovska et al., Robotics 7(1), 2018 describe it in section 2.2.

Table 1 of the paper gives the image, the frequencies and the times. Values that no source gives are marked
as assumed; a prototype with them had plausible noise, saturation and lost pixels.
"""

import math
from fractions import Fraction
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator
from scipy import constants

from rpod_schemas.config.base import Config, Name, NonNegative, Positive, Share
from rpod_schemas.config.pmd.reduced_rate import ReducedRateConfig
from rpod_schemas.config.sensor import EmulatedSensor
from rpod_schemas.poses import Pose, make_pose
from rpod_schemas.types import LENS_COEFFICIENTS, Camera, PmdInfo

MODULATION_FREQUENCIES_HZ = (5.004e6, 7.5e6, 10.007e6, 15e6, 20.013e6, 25.016e6, 30e6)
"""The seven modulation frequencies of the camera, Hz (Table 1)."""
MAX_RATE_HZ = 45.0
"""Largest frame rate of the camera, Hz (Table 1)."""
SAMPLES = 4
"""Number of samples Q1..Q4 (Eq. 1) for each frequency, of one sub-exposure each."""
SAMPLE_OFFSET = 32768
"""Value of a sample of zero electrons, counts (ICD section 2)."""
_SUB_EXPOSURE_S = {"fast": 0.004, "paper": 0.006, "dual": 0.003}
_WHOLE_RATIO = 12
"""Largest multiple: the seven are multiples of 2.5 MHz within 0.1 %, the highest of them the twelfth."""


class LampConfig(Config):
    """The modulated light beside the lens."""

    wavelength_m: Positive = 850e-9
    """Centre wavelength of the band, m (assumed)."""
    optical_power_W: Positive = 4.0
    """Mean emitted power, W (assumed; Table 1 has less than 25.5 W of electrical power)."""
    share_in_view: Share = 0.75
    """Share of the power that falls into the field of view, evenly (assumed)."""
    radius_m: Positive = 0.05
    """Radius of the disc that the LEDs fill, m; it widens the glints of smooth surfaces (assumed)."""


class LensConfig(Config):
    """The optics between the scene and the pixels."""

    f_number: Positive = 1.8
    """Focal length over aperture (assumed)."""
    transmission: Share = 0.8
    """Transmission of lens and filter in the band (assumed)."""
    stray_share: Share = 0.002
    """Share of the image's mean light that every pixel receives in addition (assumed: about 250 e-)."""
    sun_share: Share = 47.5 / 1361.0
    """Share of the sun's irradiance within the filter's 50 nm: 47.5 W/m2 of AM0's 1361 W/m2."""


class PixelConfig(Config):
    """The photonic mixer: two taps that share the light in time with the modulation."""

    pitch_m: Positive = 17.5e-6
    """Side of the square that is effectively sensitive, m (assumed)."""
    quantum_efficiency: Share = 0.45
    """Electrons per photon (assumed)."""
    contrast: Share = 0.75
    """Demodulation contrast C_d: difference of the taps over their sum for light in phase (assumed)."""
    wiggling_share: Share = 0.03
    """Third harmonic h3 of the correlation: uncalibrated 0.03, calibrated 0.003 to 0.01 (assumed)."""
    read_noise_e: NonNegative = 60.0
    """Standard deviation of the read-out noise of the taps' difference, e- (assumed)."""
    full_well_e: Positive = 150e3
    """Capacity of a tap after suppression, e- (assumed)."""
    suppression_e_s: NonNegative = 6e8
    """Largest charge that the background suppression takes off each tap, e- per second of exposure
    (assumed)."""
    electrons_per_count: Positive = 40.0
    """Step of the analogue-to-digital converter, e- (assumed)."""

    @property
    def saturation_count(self) -> int:
        """Count of a sample with one tap full and the other empty."""
        return int(self.full_well_e / self.electrons_per_count)

    @model_validator(mode="after")
    def _full_well_fits_the_samples(self) -> Self:
        if self.full_well_e / self.electrons_per_count >= SAMPLE_OFFSET:
            raise ValueError(
                f"full_well_e over electrons_per_count is {self.full_well_e / self.electrons_per_count:g}, "
                f"must be under {SAMPLE_OFFSET}: samples have 16 bits"
            )
        return self


class ReconstructionConfig(Config):
    """Limits within which a pixel keeps its depth."""

    least_amplitude_e: NonNegative = 1500.0
    """Least amplitude of a pixel with depth, e-; with 250, stray light gives half of the background a false
    depth (prototype)."""
    asymmetry_limit: Positive = 0.3
    """Largest |Q1 + Q2| and |Q3 + Q4| over twice the amplitude. Without motion and noise it is zero; its
    noise is as large as that of the phase in rad. A limit of 0.3 removes pixels that are noisier than about
    0.1 rad (assumed)."""
    wrap_limit: Share = 0.7
    """Largest disagreement of two frequencies, over half the least difference between two ways to unwrap
    them. With 1 the nearest way is always taken; a smaller limit removes pixels between two ways
    (assumed)."""


class AutomaticExposureConfig(Config):
    """Choice of the automatic exposure in half stops; each divides the time by the square root of two."""

    full_well_share: Annotated[float, Field(gt=0, le=1)] = 0.95
    """Largest share of a tap that a pixel may fill."""
    loss_share: Share = 0.05
    """Share of the lit pixels that may be too dark or too bright in addition to those at the best time. The
    longest such time is taken, so that a few glints do not make all other pixels noisy (assumed)."""
    half_stops: Annotated[int, Field(ge=0, le=24)] = 14
    """Largest number of half stops; 14 reduce the 4 ms of the profile fast to 31 us (assumed)."""


class PmdConfig(EmulatedSensor):
    """A PMD camera: optics, timing, physics and mount."""

    kind: str = "pmd"
    """Selects this sensor."""
    name: Name = "pmd"
    """Name of the sensor: prefix of its topics, and of its frame ``<name>_optical``."""
    rate_hz: Positive = 15.0
    """Number of frames per second."""
    T_chaser_sensor: Pose = Field(default_factory=make_pose)
    """Mount: pose of the optical frame in the chaser."""
    reduced_rate: ReducedRateConfig | None = None
    """Stream of reduced rate for a slow link, beside the full one. Faults of the sensor's messages
    are not in it."""
    camera: Camera = Camera(width=352, height=287, fx=682.75, fy=691.42, cx=175.5, cy=143.0)
    """Intrinsics, plumb_bob distortion included: 28.91 x 23.45 deg on 352 x 287 pixels (Table 1)."""
    profile: Literal["fast", "paper", "dual"] = "fast"
    """Profile of the exposure. fast: 4 sub-exposures of 4 ms, up to 45 Hz; paper: 4 of 6 ms, the 24 ms of
    Table 1, up to 40 Hz; dual: two frequencies and 8 sub-exposures of 3 ms, for 30 Hz and up to 38."""
    readout_s: NonNegative = 0.25e-3
    """Read-out time after each sub-exposure, s (assumed: the time left by 24 ms at 40 Hz)."""
    modulation_frequency_hz: Positive = 20.013e6
    """Modulation frequency, one of the camera's seven, Hz; not used in the profile dual. The range is
    unambiguous up to c/2f, 7.49 m at the default."""
    dual_frequencies_hz: tuple[Positive, Positive] = (20.013e6, 30e6)
    """Two of the seven modulation frequencies, Hz, for the profile dual. The range is unambiguous up to 14.98
    m at the default."""
    exposure: Literal["fixed", "automatic"] = "automatic"
    """Exposure time. fixed: that of the profile; automatic: shorter if the light of the frame itself would
    fill the taps."""
    automatic_exposure: AutomaticExposureConfig = AutomaticExposureConfig()
    """Limits of the automatic exposure."""
    subsamples: Annotated[int, Field(ge=1, le=8)] = 2
    """Number of rays across a pixel, and down; their mixture gives mixed pixels at edges."""
    lamp: LampConfig = LampConfig()
    """The modulated light."""
    lens: LensConfig = LensConfig()
    """The optics."""
    pixel: PixelConfig = PixelConfig()
    """The sensor chip."""
    reconstruction: ReconstructionConfig = ReconstructionConfig()
    """Limits of the depth's reconstruction."""

    @property
    def frequencies_hz(self) -> tuple[float, ...]:
        """Modulation frequencies in use, Hz, in the order of the phase images."""
        return self.dual_frequencies_hz if self.profile == "dual" else (self.modulation_frequency_hz,)

    @property
    def sub_exposures(self) -> int:
        """Number of sub-exposures of a frame: Q1..Q4 of the first frequency, then of the second."""
        return SAMPLES * len(self.frequencies_hz)

    @property
    def sub_exposure_s(self) -> float:
        """Integration time of one of Q1..Q4, s; the longest one if the exposure is automatic."""
        return _SUB_EXPOSURE_S[self.profile]

    @property
    def integration_time_s(self) -> float:
        """Sum of a frame's sub-exposures, s; the longest one if the exposure is automatic."""
        return self.sub_exposures * self.sub_exposure_s

    @property
    def latency_s(self) -> float:
        """Time from the stamp, the middle of the exposure, to the end of the last read-out, s."""
        return (self.sub_exposures * (self.sub_exposure_s + self.readout_s) + self.readout_s) / 2.0

    @property
    def unambiguous_range_m(self) -> float:
        """Length modulo which distances are measured, m: c / 2f, or that at which both frequencies wrap."""
        first_hz, *others_hz = self.frequencies_hz
        wraps = 1
        for other_hz in others_hz:
            wraps = Fraction(first_hz / other_hz).limit_denominator(_WHOLE_RATIO).numerator
        return wraps * constants.c / (2.0 * first_hz)

    @property
    def lamp_irradiance_W_m2(self) -> float:  # noqa: N802 - watts
        """Irradiance E1 that the lamp gives at a distance of 1 m in the field of view, W/m2."""
        half_width = math.atan(self.camera.width / (2.0 * self.camera.fx))
        half_height = math.atan(self.camera.height / (2.0 * self.camera.fy))
        solid_angle_sr = 4.0 * math.asin(math.sin(half_width) * math.sin(half_height))
        return self.lamp.optical_power_W * self.lamp.share_in_view / solid_angle_sr

    @property
    def electrons_per_radiance(self) -> float:
        """Electrons of a pixel in one sub-exposure for 1 W/m2/sr: pi / (4 N^2) tau A QE t / (h nu)."""
        photon_J = constants.h * constants.c / self.lamp.wavelength_m
        irradiance = math.pi / (4.0 * self.lens.f_number**2) * self.lens.transmission
        power_W = irradiance * self.pixel.pitch_m**2
        return power_W * self.pixel.quantum_efficiency * self.sub_exposure_s / photon_J

    def pose_times_s(self) -> tuple[float, ...]:
        """Return the middles of the sub-exposures, offsets from the stamp, s: Q1..Q4 of each frequency."""
        period_s = self.sub_exposure_s + self.readout_s
        return tuple(
            (index - (self.sub_exposures - 1) / 2.0) * period_s for index in range(self.sub_exposures)
        )

    def info(self, integration_time_s: float | None = None) -> PmdInfo:
        """Return the camera's description of itself on ``<camera>/info``.

        Args:
            integration_time_s: integration time of the next frames, s, if the exposure is automatic.
        """
        return PmdInfo(
            modulation_frequency_hz=np.array(self.frequencies_hz),
            integration_time_s=integration_time_s or self.integration_time_s,
            electrons_per_count=self.pixel.electrons_per_count,
            saturation_count=float(self.pixel.saturation_count),
        )

    @model_validator(mode="after")
    def _the_camera_is_fast_enough(self) -> Self:
        exposure_s = self.sub_exposures * (self.sub_exposure_s + self.readout_s)
        fastest_hz = min(MAX_RATE_HZ, 1.0 / exposure_s)
        if self.rate_hz > fastest_hz * (1.0 + 1e-9):
            raise ValueError(
                f"rate_hz is {self.rate_hz:g}, the profile {self.profile!r} allows {fastest_hz:g} at most"
            )
        return self

    @model_validator(mode="after")
    def _the_frequencies_exist(self) -> Self:
        known = ", ".join(f"{frequency:g}" for frequency in MODULATION_FREQUENCIES_HZ)
        if self.modulation_frequency_hz not in MODULATION_FREQUENCIES_HZ:
            raise ValueError(
                f"modulation_frequency_hz is {self.modulation_frequency_hz:g}, needs one of {known}"
            )
        first_hz, second_hz = self.dual_frequencies_hz
        if first_hz == second_hz or not {first_hz, second_hz} <= set(MODULATION_FREQUENCIES_HZ):
            raise ValueError(
                f"dual_frequencies_hz is ({first_hz:g}, {second_hz:g}), needs two different of {known}"
            )
        return self

    @model_validator(mode="after")
    def _distortion_is_whole(self) -> Self:
        if self.camera.distortion.shape not in ((5,), (LENS_COEFFICIENTS,)):
            raise ValueError(
                "camera.distortion needs five numbers: k1, k2, p1, p2, k3; or eight: with k4, k5, k6"
            )
        return self
