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
_SAME_PERIOD = 0.01
"""Relative difference of two periods below which the distances do not tell their waves apart."""
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
"""Number of successive frames that count as one in standard errors, since they share unmodelled errors; fewer
where there would be too few blocks."""
_SINGULAR = 1e-12
_BLOCKS = 3
"""Least number of blocks for each parameter: the scatter of fewer says little of its error."""
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
        CalibrationError: the distances do not cover the waves of fourth order, or there are too few frames.
    """
    orders = [(hertz, _ORDER) for hertz in samples.modulation_frequency_hz]
    for hertz, order in orders:
        _require_coverage(samples, hertz, order)
    further = _further_waves(samples, orders)
    try:
        candidate = _fit(samples, orders + further)
    except CalibrationError:  # too few frames for so many waves
        further, candidate = [], _fit(samples, orders)
    kept = [
        (wave.modulation_frequency_hz, wave.order)
        for wave in candidate.harmonics[len(orders) :]
        if wave.amplitude_m > max(_SIGNIFICANT * wave.sigma_m, _WORTH_M)
    ]
    calibration = candidate if len(kept) == len(further) else _fit(samples, orders + kept)
    return calibration.model_copy(update={"evidence": evidence(samples, calibration)})


def _further_waves(samples: DepthSamples, orders: list[tuple[float, int]]) -> list[tuple[float, int]]:
    """Return the further waves that the distances cover, as (Hz, order), each period once.

    Frequencies at a ratio of 2 or 4 have waves in common.
    """
    further: list[tuple[float, int]] = []
    for hertz in samples.modulation_frequency_hz:
        for order in _FURTHER_ORDERS:
            taken = any(
                np.isclose(hertz * order, known * waves, rtol=_SAME_PERIOD)
                for known, waves in orders + further
            )
            if not taken and _parts_covered(samples.true_m, hertz, order) == _PARTS:
                further.append((hertz, order))
    return further


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
    values, weights, slopes = _solve(design, samples.error_m, samples.true_m)
    scores = design * (weights * (samples.error_m - design @ values))[:, None]
    sigma = _standard_errors(design, scores, slopes, _blocks(samples, design.shape[1]))
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


def _solve(
    design: FloatArray, error_m: FloatArray, true_m: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the coefficients of a regression with Tukey's biweight, iteratively reweighted.

    Noise grows with the distance, so residuals are divided by the robust spread at their range. The other
    two results are of each pixel, shape (N,): its weight psi(r) / r, and the slope psi'(r), which may be
    negative.
    """
    weights: FloatArray = (np.abs(error_m - np.median(error_m)) < _GATE_M).astype(np.float64)
    number = np.unique(_bin_of(true_m), return_inverse=True)[1]
    values, slopes = np.zeros(design.shape[1]), weights
    for _ in range(_ROUNDS):
        root = np.sqrt(weights)
        values[:] = np.linalg.lstsq(root[:, None] * design, root * error_m)[0]
        residual = error_m - design @ values
        spread = np.array([_robust_sigma(residual[number == index]) for index in range(number.max() + 1)])
        sigma = np.maximum(spread, _LEAST_NOISE_M)[number]
        left = np.maximum(1.0 - (residual / (_TUKEY * sigma)) ** 2, 0.0)
        certain = (_LEAST_NOISE_M / sigma) ** 2
        weights, slopes = certain * left**2, certain * left * (5.0 * left - 4.0)
    return values, weights, slopes


def _blocks(samples: DepthSamples, parameters: int) -> IntArray:
    """Return the number of each pixel's block of successive frames, from 0, shape (N,).

    Raises:
        CalibrationError: there are no more frames than parameters.
    """
    frames, rank = np.unique(samples.frame, return_inverse=True)
    if frames.size <= parameters:
        raise CalibrationError(
            f"{frames.size} frames show faces of the target, the errors of {parameters} values follow from "
            f"more than {parameters} frames: log for longer"
        )
    length = min(max(frames.size // (_BLOCKS * parameters), 1), _BLOCK)
    return (rank // length).astype(np.int64)


def _standard_errors(
    design: FloatArray, scores: FloatArray, slopes: FloatArray, block: IntArray
) -> FloatArray:
    """Return the standard errors: a jackknife over blocks of frames, by one step of Newton for each block.

    With many blocks this is the sandwich (Liang and Zeger, 1986) with psi' in the bread (Huber, 1981, section
    6.3). With few blocks the sandwich is too small, since each block pulls the fit to its own errors.

    Args:
        design: derivatives of the errors by the parameters, shape (N, P).
        scores: rows of the design times psi of the residuals, shape (N, P).
        slopes: psi' of the residuals, shape (N,).
        block: number of each pixel's block, from 0, shape (N,).

    Raises:
        CalibrationError: a block alone determines a parameter.
    """
    number = int(block.max()) + 1
    pull = np.array([np.bincount(block, column, minlength=number) for column in scores.T]).T
    curvature = np.stack(
        [
            design[here].T @ (slopes[here][:, None] * design[here])
            for here in (block == each for each in range(number))
        ]
    )
    rest = curvature.sum(axis=0) - curvature
    certain = np.linalg.eigvalsh(rest)
    if certain.min() <= _SINGULAR * certain.max():
        raise CalibrationError(
            "a part of the frames alone determines a wave, so that its error is unknown: log for longer, "
            "with each distance at several times"
        )
    moved = np.linalg.solve(rest, pull[..., None])[..., 0]
    spread: FloatArray = ((moved - moved.mean(axis=0)) ** 2).sum(axis=0)
    return np.sqrt((number - 1) / number * spread)


def _robust_sigma(values: FloatArray) -> float:
    return float(MAD_TO_SIGMA * np.median(np.abs(values - np.median(values))))


def _rms(values: FloatArray | list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
