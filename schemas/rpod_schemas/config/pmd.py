"""The PMD camera: DLR-Argos 3D-P320, as Klionovska et al., Robotics 7(1), 2018 describe it in section 2.2.

Table 1 of the paper gives the image, the frequencies and the times. What no source gives is marked as
assumed; a prototype with these values was plausible in its noise, its saturation and its lost pixels.
"""

import math
from fractions import Fraction
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator
from scipy import constants

from rpod_schemas.config.base import Config, Name, NonNegative, Positive, Share
from rpod_schemas.config.sensor import EmulatedSensor
from rpod_schemas.poses import Pose, make_pose
from rpod_schemas.types import Camera, PmdInfo

MODULATION_FREQUENCIES_HZ = (5.004e6, 7.5e6, 10.007e6, 15e6, 20.013e6, 25.016e6, 30e6)
"""The camera's seven (Table 1)."""
MAX_RATE_HZ = 45.0
"""Table 1."""
SAMPLES = 4
"""Q1..Q4 (Eq. 1), one sub-exposure each, for each frequency."""
SAMPLE_OFFSET = 32768
"""What a sample of zero electrons reads (ICD section 2)."""
_SUB_EXPOSURE_S = {"fast": 0.004, "paper": 0.006, "dual": 0.003}
_WHOLE_RATIO = 12
"""The seven are multiples of 2.5 MHz within 0.1 %, the highest of them the twelfth."""


class LampConfig(Config):
    """The modulated light beside the lens."""

    wavelength_m: Positive = 850e-9
    """Centre of the band (assumed)."""
    optical_power_W: Positive = 4.0
    """Mean emitted power (assumed; Table 1 has less than 25.5 W of electrical power)."""
    share_in_view: Share = 0.75
    """Share of the power that falls into the field of view, evenly (assumed)."""
    radius_m: Positive = 0.05
    """Radius of the disc that the LEDs fill: it widens the glints of smooth surfaces (assumed)."""


class LensConfig(Config):
    """From radiance to the light on a pixel."""

    f_number: Positive = 1.8
    """Focal length over aperture (assumed)."""
    transmission: Share = 0.8
    """Of lens and filter in the band (assumed)."""
    stray_share: Share = 0.002
    """Share of the image's mean light that every pixel receives as well (assumed: some 250 e-)."""
    sun_share: Share = 47.5 / 1361.0
    """Share of the sun's irradiance within the filter's 50 nm: 47.5 W/m2 of AM0's 1361 W/m2."""


class PixelConfig(Config):
    """The photonic mixer: two taps that share the light in time with the modulation."""

    pitch_m: Positive = 17.5e-6
    """Side of the square that is effectively sensitive (assumed)."""
    quantum_efficiency: Share = 0.45
    """Electrons per photon (assumed)."""
    contrast: Share = 0.75
    """Demodulation contrast C_d: difference of the taps over their sum for light in phase (assumed)."""
    wiggling_share: Share = 0.03
    """Third harmonic of the correlation, h3: uncalibrated 0.03, calibrated 0.003 to 0.01 (assumed)."""
    read_noise_e: NonNegative = 60.0
    """Standard deviation of the difference of the taps as it is read (assumed)."""
    full_well_e: Positive = 150e3
    """Capacity of a tap after suppression (assumed)."""
    suppression_e_s: NonNegative = 6e8
    """Most charge that the background suppression takes off each tap, per second of exposure (assumed)."""
    electrons_per_count: Positive = 40.0
    """Step of the analogue-to-digital converter (assumed)."""

    @property
    def saturation_count(self) -> int:
        """Count of a sample with one tap full and the other empty."""
        return int(self.full_well_e / self.electrons_per_count)

    @model_validator(mode="after")
    def _full_well_fits_the_samples(self) -> Self:
        if self.full_well_e / self.electrons_per_count >= SAMPLE_OFFSET:
            raise ValueError(
                f"full_well_e over electrons_per_count must be under {SAMPLE_OFFSET}: samples have 16 bits"
            )
        return self


class ReconstructionConfig(Config):
    """Which pixels keep their depth."""

    least_amplitude_e: NonNegative = 1500.0
    """Below it there is no depth; at 250 stray light makes ghosts of half the background (prototype)."""
    asymmetry_limit: Positive = 0.3
    """Most of |Q1 + Q2| and |Q3 + Q4| over twice the amplitude. It is zero but for motion and noise, which is
    as large as the phase's in rad: 0.3 loses what is noisier than about 0.1 rad (assumed)."""
    wrap_limit: Share = 0.7
    """Most that two frequencies may disagree, over half the least difference between two ways to unwrap them:
    1 takes the nearest way whatever it is, less loses what lies between two ways (assumed)."""


class AutomaticExposureConfig(Config):
    """How the automatic exposure chooses, in half stops: each divides the time by the square root of two."""

    full_well_share: Annotated[float, Field(gt=0, le=1)] = 0.95
    """Share of a tap that a pixel may fill."""
    loss_share: Share = 0.05
    """Of the lit pixels, how many more may be too dark or too bright than at the best time. The longest such
    time is taken: a few glints do not make all other pixels noisy (assumed)."""
    half_stops: Annotated[int, Field(ge=0, le=24)] = 14
    """Most of them: 14 take the 4 ms of the profile fast down to 31 us (assumed)."""


class PmdConfig(EmulatedSensor):
    """A PMD camera: optics, timing, physics and mount."""

    kind: str = "pmd"
    """Selects this sensor."""
    name: Name = "pmd"
    """Prefix of its topics, and of its frame ``<name>_optical``."""
    rate_hz: Positive = 15.0
    """Frames per second."""
    T_chaser_sensor: Pose = Field(default_factory=make_pose)
    """Mount: pose of the optical frame in the chaser."""
    camera: Camera = Camera(width=352, height=287, fx=682.75, fy=691.42, cx=175.5, cy=143.0)
    """Intrinsics, plumb_bob distortion included: 28.91 x 23.45 deg on 352 x 287 pixels (Table 1)."""
    profile: Literal["fast", "paper", "dual"] = "fast"
    """fast: 4 sub-exposures of 4 ms, up to 45 Hz; paper: of 6 ms, the 24 ms of Table 1, up to 40 Hz; dual:
    two frequencies and 8 sub-exposures of 3 ms, for 30 Hz and up to 38."""
    readout_s: NonNegative = 0.25e-3
    """After each sub-exposure (assumed: what 24 ms leave at 40 Hz)."""
    modulation_frequency_hz: Positive = 20.013e6
    """One of the camera's seven; the range is unambiguous up to c/2f, 7.49 m at the default. Not for dual."""
    dual_frequencies_hz: tuple[Positive, Positive] = (20.013e6, 30e6)
    """Two of the seven, for the profile dual; unambiguous up to 14.98 m at the default."""
    exposure: Literal["fixed", "automatic"] = "automatic"
    """fixed: the profile's times; automatic: shorter where the very frame's light would fill the taps."""
    automatic_exposure: AutomaticExposureConfig = AutomaticExposureConfig()
    """How short."""
    subsamples: Annotated[int, Field(ge=1, le=8)] = 2
    """Rays across a pixel, and down: what mixes at edges."""
    lamp: LampConfig = LampConfig()
    """The light."""
    lens: LensConfig = LensConfig()
    """The optics."""
    pixel: PixelConfig = PixelConfig()
    """The sensor chip."""
    reconstruction: ReconstructionConfig = ReconstructionConfig()
    """The masks."""

    @property
    def frequencies_hz(self) -> tuple[float, ...]:
        """Modulation frequencies in use, in the order of the phase images."""
        return self.dual_frequencies_hz if self.profile == "dual" else (self.modulation_frequency_hz,)

    @property
    def sub_exposures(self) -> int:
        """Of a frame: Q1..Q4 of the first frequency, then of the second."""
        return SAMPLES * len(self.frequencies_hz)

    @property
    def sub_exposure_s(self) -> float:
        """Integration time of one of Q1..Q4; the longest where the exposure is automatic."""
        return _SUB_EXPOSURE_S[self.profile]

    @property
    def integration_time_s(self) -> float:
        """Of a frame: the sum of its sub-exposures; the longest where the exposure is automatic."""
        return self.sub_exposures * self.sub_exposure_s

    @property
    def latency_s(self) -> float:
        """From the stamp, the middle of the exposure, to the end of the last read-out."""
        return (self.sub_exposures * (self.sub_exposure_s + self.readout_s) + self.readout_s) / 2.0

    @property
    def unambiguous_range_m(self) -> float:
        """Distances are measured modulo this: c / 2f, or the length at which two frequencies wrap at once."""
        first_hz, *others_hz = self.frequencies_hz
        wraps = 1
        for other_hz in others_hz:
            wraps = Fraction(first_hz / other_hz).limit_denominator(_WHOLE_RATIO).numerator
        return wraps * constants.c / (2.0 * first_hz)

    @property
    def lamp_irradiance_W_m2(self) -> float:  # noqa: N802 - watts
        """E1, what the lamp gives at a distance of 1 m in the field of view."""
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
        """Return the middles of the sub-exposures, offsets from the stamp: Q1..Q4 of each frequency."""
        period_s = self.sub_exposure_s + self.readout_s
        return tuple(
            (index - (self.sub_exposures - 1) / 2.0) * period_s for index in range(self.sub_exposures)
        )

    def info(self, integration_time_s: float | None = None) -> PmdInfo:
        """Return what the camera says of itself on ``<camera>/info``.

        Args:
            integration_time_s: of the frames from now on, where the exposure is automatic.
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
    def _distortion_is_plumb_bob(self) -> Self:
        if self.camera.distortion.shape != (5,):
            raise ValueError("camera.distortion needs five numbers: k1, k2, p1, p2, k3")
        return self
