"""Calibration of a PMD camera's distances from logged frames with truth: offset and wiggling.

Klionovska et al. 2018 have no such calibration, and name that as the cause of their errors in range. The
error is fitted as a function of the *true* distance, which has no noise, so that noise does not flatten
the waves; the estimator inverts it. Waves of fourth order (a third harmonic of the correlation) are always
fitted. Waves of second and eighth order are kept if the logs cover them and they are significant.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rpod_analysis.calibration.depth_samples import DepthSamples
from rpod_analysis.errors import CalibrationError
from rpod_analysis.scoring.score import IntArray
from rpod_pose.pmd.depth_preparation import calibrated
from rpod_schemas.arrays import MAD_TO_SIGMA, FloatArray
from rpod_schemas.config.pmd.depth_calibration import (
    CalibrationEvidence,
    DepthCalibration,
    Harmonic,
    unambiguous_range_m,
)

_ORDER = 4
_FURTHER_ORDERS = (2, 8)
_PARTS = 8
"""Number of parts of a wave, all of which must be covered."""
_LEAST_IN_PART = 100
"""Least number of pixels that cover a part."""
_GATE_M = 0.5
"""Greatest difference of an error from the median; pixels beyond it measure another object."""
_TUKEY = 4.685
"""Width of Tukey's biweight in robust standard deviations: 95 % efficient for normal errors."""
_ROUNDS = 20
_LEAST_NOISE_M = 0.01
"""Least noise in the weight of a pixel, m: below it the remaining errors are systematic."""
_BLOCK = 10
"""Number of successive frames that count as one in standard errors, since they share unmodelled errors."""
_SIGNIFICANT = 4.0
"""Least amplitude of a further wave, in standard errors."""
_WORTH_M = 0.5e-3
"""Least amplitude of a further wave."""
_BIN_M = 0.25
_LEAST_IN_BIN = 30
_KNOWN_M = 0.005
"""Greatest standard error with which the bias of a range is reported."""


@dataclass(frozen=True)
class RangeBin:
    """Errors of the pixels in a range of true distances, m."""

    from_m: float
    to_m: float
    pixels: int
    bias_before_m: float
    """Median of measured minus true distance."""
    bias_after_m: float
    """The same after calibration."""
    noise_m: float
    """Robust standard deviation after calibration."""

    @property
    def bias_sigma_m(self) -> float:
        """Standard error of the medians."""
        return 1.253 * self.noise_m / math.sqrt(self.pixels)


def fit(samples: DepthSamples) -> DepthCalibration:
    """Return the calibration fitted to the errors of the pixels.

    Raises:
        CalibrationError: the distances do not cover the waves of fourth order.
    """
    orders = [(hertz, _ORDER) for hertz in samples.modulation_frequency_hz]
    for hertz, order in orders:
        _require_coverage(samples, hertz, order)
    further = [
        (hertz, order)
        for hertz in samples.modulation_frequency_hz
        for order in _FURTHER_ORDERS
        if _parts_covered(samples.true_m, hertz, order) == _PARTS
        and not any(np.isclose(hertz * order, known * waves) for known, waves in orders)
    ]
    candidate = _fit(samples, orders + further)
    kept = [
        (wave.modulation_frequency_hz, wave.order)
        for wave in candidate.harmonics[len(orders) :]
        if wave.amplitude_m > max(_SIGNIFICANT * wave.sigma_m, _WORTH_M)
    ]
    calibration = candidate if len(kept) == len(further) else _fit(samples, orders + kept)
    return calibration.model_copy(update={"evidence": evidence(samples, calibration)})


def range_bins(samples: DepthSamples, calibration: DepthCalibration) -> list[RangeBin]:
    """Return errors before and after a calibration by true distance, in steps of 0.25 m."""
    after_m = _error_after(samples, calibration)
    number = _bin_of(samples.true_m)
    return [
        RangeBin(
            from_m=float(index * _BIN_M),
            to_m=float((index + 1) * _BIN_M),
            pixels=int(here.sum()),
            bias_before_m=float(np.median(samples.error_m[here])),
            bias_after_m=float(np.median(after_m[here])),
            noise_m=_robust_sigma(after_m[here]),
        )
        for index in np.unique(number)
        if (here := number == index).sum() >= _LEAST_IN_BIN
    ]


def evidence(samples: DepthSamples, calibration: DepthCalibration) -> CalibrationEvidence:
    """Return the errors before and after a calibration on pixels, its own or others.

    Raises:
        CalibrationError: the pixels are of a camera with another modulation frequency, or there are too few.
    """
    if not np.array_equal(samples.modulation_frequency_hz, calibration.modulation_frequency_hz):
        raise CalibrationError(
            f"modulation_frequency_hz is {samples.modulation_frequency_hz} in the logs, "
            f"{calibration.modulation_frequency_hz} in the calibration; calibrate for this frequency"
        )
    bins = [part for part in range_bins(samples, calibration) if part.bias_sigma_m < _KNOWN_M]
    if not bins:
        raise CalibrationError(
            f"{samples.true_m.size} pixels on faces of the target are too few, or too noisy; give more logs"
        )
    after_m = _error_after(samples, calibration)
    usable = np.abs(samples.error_m - np.median(samples.error_m)) < _GATE_M
    return CalibrationEvidence(
        logs=samples.logs,
        target=samples.target,
        frames=samples.frames,
        pixels=samples.true_m.size,
        range_m=(float(samples.true_m.min()), float(samples.true_m.max())),
        rms_before_m=_rms(samples.error_m[usable]),
        rms_after_m=_rms(after_m[usable]),
        bias_before_m=_rms([part.bias_before_m for part in bins]),
        bias_after_m=_rms([part.bias_after_m for part in bins]),
    )


def _error_after(samples: DepthSamples, calibration: DepthCalibration) -> FloatArray:
    return calibrated(calibration, samples.true_m + samples.error_m) - samples.true_m


def _bin_of(true_m: FloatArray) -> IntArray:
    return np.floor(true_m / _BIN_M).astype(np.int64)


def _parts_of_wave(true_m: FloatArray, hertz: float, order: int) -> IntArray:
    turns = true_m * order / unambiguous_range_m(hertz)
    return np.floor(turns % 1.0 * _PARTS).astype(np.int64)


def _parts_covered(true_m: FloatArray, hertz: float, order: int) -> int:
    counts = np.bincount(_parts_of_wave(true_m, hertz, order), minlength=_PARTS)
    return int((counts >= _LEAST_IN_PART).sum())


def _require_coverage(samples: DepthSamples, hertz: float, order: int) -> None:
    covered = _parts_covered(samples.true_m, hertz, order)
    if covered < _PARTS:
        period_m = unambiguous_range_m(hertz) / order
        raise CalibrationError(
            f"distances from {samples.true_m.min():.2f} to {samples.true_m.max():.2f} m cover {covered} of "
            f"the {_PARTS} parts of a wave of {period_m:.2f} m ({hertz / 1e6:g} MHz): "
            "the target must move by at least this length"
        )


def _fit(samples: DepthSamples, orders: Sequence[tuple[float, int]]) -> DepthCalibration:
    design = np.column_stack(
        [np.ones_like(samples.true_m)]
        + [
            wave(2.0 * np.pi * order / unambiguous_range_m(hertz) * samples.true_m)
            for hertz, order in orders
            for wave in (np.cos, np.sin)
        ]
    )
    values, weights = _solve(design, samples.error_m, samples.true_m)
    sigma = _standard_errors(design, weights, samples.error_m - design @ values, samples.frame // _BLOCK)
    return DepthCalibration(
        modulation_frequency_hz=samples.modulation_frequency_hz,
        offset_m=float(values[0]),
        offset_sigma_m=float(sigma[0]),
        harmonics=tuple(
            Harmonic(
                modulation_frequency_hz=hertz,
                order=order,
                cos_m=float(values[1 + 2 * index]),
                sin_m=float(values[2 + 2 * index]),
                sigma_m=float(sigma[1 + 2 * index : 3 + 2 * index].max()),
            )
            for index, (hertz, order) in enumerate(orders)
        ),
    )


def _solve(design: FloatArray, error_m: FloatArray, true_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients and weights of a regression with Tukey's biweight, iteratively reweighted.

    Noise grows with the distance, so residuals are divided by the robust spread at their range.
    """
    weights: FloatArray = (np.abs(error_m - np.median(error_m)) < _GATE_M).astype(np.float64)
    number = np.unique(_bin_of(true_m), return_inverse=True)[1]
    values = np.zeros(design.shape[1])
    for _ in range(_ROUNDS):
        root = np.sqrt(weights)
        values[:] = np.linalg.lstsq(root[:, None] * design, root * error_m)[0]
        residual = error_m - design @ values
        spread = np.array([_robust_sigma(residual[number == index]) for index in range(number.max() + 1)])
        sigma = np.maximum(spread, _LEAST_NOISE_M)[number]
        weights = (np.maximum(1.0 - (residual / (_TUKEY * sigma)) ** 2, 0.0) * _LEAST_NOISE_M / sigma) ** 2
    return values, weights


def _standard_errors(
    design: FloatArray, weights: FloatArray, residual: FloatArray, block: IntArray
) -> FloatArray:
    """Return the standard errors: the sandwich over blocks of frames (Liang and Zeger, 1986)."""
    blocks, member = np.unique(block, return_inverse=True)
    scores = np.zeros((blocks.size, design.shape[1]))
    np.add.at(scores, member, design * (weights * residual)[:, None])
    bread = np.linalg.inv(design.T @ (weights[:, None] * design))
    correction = blocks.size / max(blocks.size - 1, 1)
    variance: FloatArray = correction * np.diag(bread @ scores.T @ scores @ bread)
    return np.sqrt(variance)


def _robust_sigma(values: FloatArray) -> float:
    return float(MAD_TO_SIGMA * np.median(np.abs(values - np.median(values))))


def _rms(values: FloatArray | list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
