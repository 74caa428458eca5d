"""Systematic error of a PMD camera's distances: offset and wiggling, as ``rpod calibrate`` finds them.

The correlation of a real camera is no pure cosine. A third harmonic of share h3 turns the phase of Eq. 1
(Klionovska et al. 2018) from phi into phi + arg(1 + h3 exp(-4 i phi)), phi - h3 sin(4 phi) to first order:
four waves in the unambiguous range, 36 mm high at 20 MHz and h3 = 0.03. Other harmonics add other orders.
"""

import math
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
import yaml
from pydantic import BeforeValidator, Field, model_validator
from scipy import constants

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.base import Config, NonNegative, Positive, load

Finite = Annotated[float, Field(allow_inf_nan=False)]
_STEEPEST = 0.5
"""Most that the error may change over a distance, m/m: beyond 1 two distances would be measured alike."""


def unambiguous_range_m(modulation_frequency_hz: float) -> float:
    """Return c / 2f: distances are measured modulo it."""
    return constants.c / (2.0 * modulation_frequency_hz)


class Harmonic(Config):
    """A wave of the error, cos_m cos(k phi) + sin_m sin(k phi), where phi = 4 pi f d / c at a distance d."""

    modulation_frequency_hz: Positive
    """f, the modulation frequency whose distances have this error."""
    order: Annotated[int, Field(gt=0)]
    """k, the number of waves in the unambiguous range."""
    cos_m: Finite
    """Amplitude of the cosine, taken off every distance."""
    sin_m: Finite
    """Amplitude of the sine, taken off every distance."""
    sigma_m: NonNegative = 0.0
    """Standard error of either amplitude; for information."""

    @property
    def period_m(self) -> float:
        """C / 2fk."""
        return unambiguous_range_m(self.modulation_frequency_hz) / self.order

    @property
    def amplitude_m(self) -> float:
        """Height of the wave."""
        return math.hypot(self.cos_m, self.sin_m)


class CalibrationEvidence(Config):
    """What a calibration rests on; nothing of it is needed to apply it."""

    logs: tuple[str, ...]
    """Names of the logs it was found in."""
    target: str
    """Name of the target whose surface was the reference."""
    frames: Annotated[int, Field(gt=0)]
    """Number of frames with truth and usable pixels."""
    pixels: Annotated[int, Field(gt=0)]
    """Number of pixels that were used."""
    range_m: tuple[Positive, Positive]
    """Least and greatest true distance; it holds between them."""
    rms_before_m: NonNegative
    """RMS of the pixels' errors, noise included."""
    rms_after_m: NonNegative
    """RMS of the pixels' errors once calibrated."""
    bias_before_m: NonNegative
    """RMS of the median errors of ranges of 0.25 m: what is left once the noise is averaged away."""
    bias_after_m: NonNegative
    """The same once calibrated; the joint tracker takes it for the sigma of the ranges' bias."""


class DepthCalibration(Config):
    """Error of a measured radial distance as a function of the true one: measured = true + error(true)."""

    modulation_frequency_hz: tuple[Positive, ...] = Field(min_length=1)
    """Of the camera that was calibrated, in the order of ``<camera>/info``; another one is refused."""
    offset_m: Finite = 0.0
    """Error that all distances share, taken off each."""
    offset_sigma_m: NonNegative = 0.0
    """Standard error of the offset; for information."""
    harmonics: tuple[Harmonic, ...] = ()
    """The wiggling."""
    evidence: CalibrationEvidence | None = None
    """Where it comes from."""

    def error_m(self, true_m: FloatArray) -> FloatArray:
        """Return measured minus true distance at true radial distances, m, any shape."""
        error = np.full_like(true_m, self.offset_m, dtype=np.float64)
        for wave in self.harmonics:
            angle = 2.0 * np.pi / wave.period_m * true_m
            error += wave.cos_m * np.cos(angle) + wave.sin_m * np.sin(angle)
        return error

    def write(self, path: Path) -> Path:
        """Write the file that ``PmdInput.calibration`` takes, YAML, or JSON by its suffix."""
        if path.suffix == ".json":
            text = self.model_dump_json(indent=2) + "\n"
        else:
            text = yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False)
        path.write_text(text, encoding="utf-8")
        return path

    @model_validator(mode="after")
    def _distances_stay_in_order(self) -> Self:
        steepest = sum(2.0 * math.pi / wave.period_m * wave.amplitude_m for wave in self.harmonics)
        if steepest > _STEEPEST:
            raise ValueError(
                f"harmonics change by up to {steepest:.2f} m per metre, {_STEEPEST:g} at most can be undone"
            )
        return self


def _read(value: Any) -> Any:
    return load(DepthCalibration, Path(value)) if isinstance(value, str | Path) else value


CalibrationSource = Annotated[DepthCalibration, BeforeValidator(_read)]
"""A calibration, written inline or as the path of its file; resolved, it is the calibration itself."""
