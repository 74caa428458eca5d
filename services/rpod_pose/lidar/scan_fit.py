"""How well a pose explains a scan: the likelihood of every ray, hit or missed.

The target is cast at the pose. A ray that should meet it comes back with the probability P_D (2015 paper,
Eq. 4) and then with a range error that is a mixture of two normal ones, sigma and 4 sigma; one that should
meet nothing comes back with a small probability, at any range. The logarithms add up to the scan's.

The same sum has an expectation and a variance under the pose itself, so that the *deficit*, expected minus
actual, says how badly the scan speaks against it, without any other pose to compare with: a right pose lacks
nothing but chance, a wrong one lacks several units a return.
"""

from dataclasses import dataclass
from math import log, sqrt
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf
from scipy.stats import norm, qmc

from rpod_geometry.rays import cast
from rpod_pose.belief import Belief, contradicted
from rpod_pose.lidar.scan_likelihood import agreed, judged, likeliest, told
from rpod_pose.lidar.scan_view import ScanView, SeenScan
from rpod_pose.registration.surface_model import SurfaceModel
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.lidar_search import ScanModelConfig, ScanVerdictConfig
from rpod_schemas.poses import pose_of

LEAST_DEVIATION = 3.0
"""Of a deficit, where nothing is left to chance."""
MARGIN = 3
"""Rows and columns beside a target that it may reach while a pose is sharpened."""
_TABLE = np.arange(0.0, 64.0, 0.25)
"""Signal-to-noise ratios at which P_D is tabulated; beyond the last it is as good as one."""

_ROUNDS, _SAMPLES, _ELITE = 4, 64, 10
_DRAWS = norm.ppf(qmc.Sobol(6, seed=1).random(_ROUNDS * _SAMPLES).clip(1e-3, 1.0 - 1e-3)).reshape(
    _ROUNDS, _SAMPLES, 6
)
"""Standard normal samples, spread evenly, the same in every search."""


@dataclass(frozen=True, eq=False)
class Agreement:
    """Which rays agree with a pose."""

    agreeing: int
    """Returns where one was predicted, at the predicted range."""
    contrary: int
    """Returns where none was predicted, or at another range."""
    missing: float
    """Predicted returns that are lacking beyond what P_D lets expect."""

    @classmethod
    def of(cls, agreeing: int, contrary: int, missed: float, expected_missed: float) -> Self:
        """Return the agreement of counted rays: an excess of one standard deviation is left to chance."""
        return cls(agreeing, contrary, max(0.0, missed - expected_missed - sqrt(expected_missed)))

    @property
    def share(self) -> float:
        """Of the rays where scan or model say "return", the share that agrees; NaN where there is none."""
        asked = self.agreeing + self.contrary + self.missing
        return self.agreeing / asked if asked else float("nan")


@dataclass(frozen=True, eq=False)
class ScanFit:
    """How well a pose explains a scan."""

    log_likelihood: float
    deficit: float
    """Expected minus actual log likelihood."""
    deviation: float
    """Standard deviation of the deficit under the pose."""
    agreement: Agreement


class ScanModel:
    """The statistics of a sensor's scans of a target."""

    def __init__(
        self, config: ScanModelConfig, verdict: ScanVerdictConfig, view: ScanView, surface: SurfaceModel
    ) -> None:
        self._view, self._faces, self._verdict = view, surface.faces, verdict
        self.detection = detection_table(config)
        self._chances, self._noise = _chances(config), _noise(config)
        buffers = view.hits.range_m, view.hits.triangle
        self._asked = view.grid.arrays, surface.faces, self._chances, self._noise, buffers
        pessimistic = verdict.pessimistic
        self._asked_of_less = (*self._asked[:2], _chances(pessimistic), _noise(pessimistic), buffers)

    def fit(self, seen: SeenScan, R: FloatArray, t: FloatArray) -> ScanFit:
        """Return how well the pose R, t of the target in the sensor explains a scan."""
        return _fit(*judged(seen.range_m, (R, t), *self._asked))

    def agreement(self, seen: SeenScan, R: FloatArray, t: FloatArray) -> Agreement:
        """Return that part of ``fit`` alone, which takes half its time."""
        return Agreement.of(*agreed(seen.range_m, (R, t), *self._asked))

    def log_likelihood(self, seen: SeenScan, R: FloatArray, t: FloatArray) -> float:
        """Return that part of ``fit`` alone."""
        return float(told(seen.range_m, (R, t), *self._asked))

    def belief(self, seen: SeenScan, R: FloatArray, t: FloatArray, fit: ScanFit) -> Belief:
        """Return whether a pose, whose fit is known, explains a scan."""
        rays = fit.agreement
        evidence = {
            "deficit": fit.deficit,
            "deficit_sigma": fit.deviation,
            "returns": float(seen.returns),
            "agreeing_share": rays.share,
        }
        if self._content(fit, seen.returns):
            return Belief(evidence=evidence)
        less = _fit(*judged(seen.range_m, (R, t), *self._asked_of_less))
        if self._content(less, seen.returns):
            return Belief(evidence=evidence)
        reason = (
            f"does not explain the scan: of {seen.returns} returns {rays.contrary} contradict the pose, "
            f"{rays.missing:.0f} more are missing"
        )
        return contradicted(reason, **evidence)

    def _content(self, fit: ScanFit, returns: int) -> bool:
        verdict = self._verdict
        most = verdict.max_deficit * max(fit.deviation, LEAST_DEVIATION)
        contrary = verdict.contrary_share + 2.0 * sqrt(verdict.contrary_share / returns)
        return (
            fit.deficit <= most + verdict.max_deficit_per_return * returns
            and fit.agreement.share >= 1.0 - contrary
        )

    def sharpen(
        self, seen: SeenScan, R: FloatArray, t: FloatArray, covariance: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the likeliest pose R, t near one, whose uncertainty is known roughly.

        Few returns on faces leave motions open that the outline still tells of: which rays meet the target.
        The likelihood is searched, since such steps have no gradient: samples of a normal distribution that
        follows the best of them (the cross-entropy method, R. Y. Rubinstein, 1999).

        Args:
            seen: the scan.
            R: of the target in the sensor, shape (3, 3).
            t: of the target in the sensor, shape (3,), m.
            covariance: of (dtau, dtheta) of ``normal_equations``, shape (6, 6).
        """
        hits = self._view.hits
        cast(self._view.grid, self._faces[0], pose_of(R, t), out=hits)
        rows, columns = _around((seen.range_m > 0.0) | (hits.triangle >= 0))
        measured = np.ascontiguousarray(seen.range_m[rows, columns])
        sharper: tuple[FloatArray, FloatArray] = likeliest(
            measured,
            (R, t),
            self._view.grid.block(rows, columns),
            self._faces,
            self._chances,
            self._noise,
            (np.empty(measured.shape, np.float32), np.empty(measured.shape, np.int32)),
            covariance,
            _DRAWS,
            _ELITE,
        )
        return sharper


def _fit(actual: float, moments: tuple[float, float], counts: tuple[int, int, float, float]) -> ScanFit:
    """Return the fit of what ``judged`` returns."""
    expected, variance = moments
    return ScanFit(actual, expected - actual, sqrt(variance), Agreement.of(*counts))


def _around(rays: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return the rows and columns that hold some rays, and a margin."""
    row, column = (np.flatnonzero(rays.any(axis=axis)) for axis in (1, 0))
    return _widened(row), _widened(column)


def _widened(lines: NDArray[np.intp]) -> slice:
    return slice(max(0, lines[0] - MARGIN), lines[-1] + 1 + MARGIN)


def _noise(config: ScanModelConfig) -> tuple[float, ...]:
    """Return sigma, slack, outlier share, clutter share and clutter density, as the kernels take them."""
    return (
        config.sigma_range_m,
        config.slack_m,
        config.outlier_share,
        config.clutter_share,
        config.clutter_share / config.clutter_depth_m,
    )


def detection_table(config: ScanModelConfig) -> tuple[float, FloatArray]:
    """Return P_D over the echo rho cos(theta) / R^2: steps of the table a unit of echo, and the table."""
    logarithm = log(1.0 / config.false_alarm)
    level = 0.5 * logarithm if config.threshold == "printed" else sqrt(logarithm)
    probability = 0.5 * (1.0 + erf(np.sqrt(0.5 + _TABLE) - level))
    return config.snr_m2 / (_TABLE[1] - _TABLE[0]), np.minimum(probability, config.surest_detection)


def _chances(config: ScanModelConfig) -> tuple[float, FloatArray]:
    """Return ``detection_table`` with clutter in the way, and its table's logarithms: of p and of 1 - p."""
    steps, table = detection_table(config)
    p = (1.0 - config.clutter_share) * table
    return steps, np.stack((p, np.log(p + 1e-9), np.log(1.0 - p)))
