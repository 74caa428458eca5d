"""Systematic error of a PMD camera's distances: offset and wiggling, as ``rpod calibrate depth`` finds them.

The correlation of a real camera is no pure cosine. A third harmonic of share h3 turns the phase of Eq. 1
(Klionovska et al. 2018) from phi into phi + arg(1 + h3 exp(-4 i phi)), phi - h3 sin(4 phi) to first order:
four waves in the unambiguous range, 36 mm high at 20 MHz and h3 = 0.03. Other harmonics add other orders.
"""

import math
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator
from scipy import constants

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.base import Config, Count, Finite, NonNegative, Positive, in_place, load, write

_STEEPEST = 0.5
"""Largest change of the error with the distance, m/m; above 1 two distances would be measured as one."""


def unambiguous_range_m(modulation_frequency_hz: float) -> float:
    """Return the unambiguous range c / 2f, m; distances are measured modulo this length."""
    return constants.c / (2.0 * modulation_frequency_hz)


class Harmonic(Config):
    """A wave of the error, cos_m cos(k phi) + sin_m sin(k phi), where phi = 4 pi f d / c at a distance d."""

    modulation_frequency_hz: Positive
    """Modulation frequency f whose distances have this error, Hz."""
    order: Count
    """Number k of waves in the unambiguous range."""
    cos_m: Finite
    """Amplitude of the cosine, m; the wave is subtracted from every distance."""
    sin_m: Finite
    """Amplitude of the sine, m; the wave is subtracted from every distance."""
    sigma_m: NonNegative = 0.0
    """Standard error of each amplitude, m; for information."""

    @property
    def period_m(self) -> float:
        """Period of the wave, c / 2fk, m."""
        return unambiguous_range_m(self.modulation_frequency_hz) / self.order

    @property
    def amplitude_m(self) -> float:
        """Amplitude of the wave, m."""
        return math.hypot(self.cos_m, self.sin_m)


class CalibrationEvidence(Config):
    """Data from which a calibration was derived. Only ``bias_after_m`` is used when it is applied."""

    logs: tuple[str, ...]
    """Names of the logs from which the calibration was derived."""
    target: str
    """Name of the target whose surface was the reference."""
    frames: Count
    """Number of frames with truth and usable pixels."""
    pixels: Count
    """Number of pixels that were used."""
    range_m: tuple[Positive, Positive]
    """Least and greatest true distance, m; the calibration is valid between them."""
    rms_before_m: NonNegative
    """RMS of the pixels' errors before calibration, noise included, m."""
    rms_after_m: NonNegative
    """RMS of the pixels' errors after calibration, noise included, m."""
    bias_before_m: NonNegative
    """RMS of the median errors in range bins of 0.25 m before calibration, with the noise averaged out, m."""
    bias_after_m: NonNegative
    """The same after calibration, m; the joint tracker takes it as the sigma of the ranges' bias."""


class DepthCalibration(Config):
    """Error of a measured radial distance as a function of the true one: measured = true + error(true)."""

    modulation_frequency_hz: tuple[Positive, ...] = Field(min_length=1)
    """Modulation frequencies of the calibrated camera, Hz, in the order of ``<camera>/info``. A camera with
    other frequencies is refused."""
    offset_m: Finite = 0.0
    """Error that all distances share, m; it is subtracted from each."""
    offset_sigma_m: NonNegative = 0.0
    """Standard error of the offset, m; for information."""
    harmonics: tuple[Harmonic, ...] = ()
    """Periodic errors of the distances (wiggling), subtracted from each."""
    evidence: CalibrationEvidence | None = None
    """Data from which the calibration was derived."""

    def error_m(self, true_m: FloatArray) -> FloatArray:
        """Return measured minus true distance, m, at true radial distances, m, any shape."""
        error = np.full_like(true_m, self.offset_m, dtype=np.float64)
        for wave in self.harmonics:
            angle = 2.0 * np.pi / wave.period_m * true_m
            error += wave.cos_m * np.cos(angle) + wave.sin_m * np.sin(angle)
        return error

    def write(self, path: Path) -> Path:
        """Write the file for ``PmdInput.calibration``, as JSON or YAML by its suffix, and return its path."""
        return write(self, path)

    @model_validator(mode="after")
    def _distances_stay_in_order(self) -> Self:
        steepest = sum(2.0 * math.pi / wave.period_m * wave.amplitude_m for wave in self.harmonics)
        if steepest > _STEEPEST:
            raise ValueError(
                f"harmonics change by {steepest:.2f} m per metre, {_STEEPEST:g} at most can be corrected"
            )
        return self


def _read(value: Any) -> Any:
    return in_place(value, lambda path: load(DepthCalibration, path))


CalibrationSource = Annotated[DepthCalibration, BeforeValidator(_read)]
"""A calibration, written inline or as the path of its file; the resolved value is the calibration itself."""
