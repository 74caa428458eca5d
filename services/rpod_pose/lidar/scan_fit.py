"""How well a pose explains a scan: the likelihood of every ray, hit or missed.

The target is cast at the pose. A ray that should meet it comes back with a probability that the scan tells
itself (``detection``), and then with a range error of heavy tails whose scale is what the sensor says of
itself (``scan_likelihood``); one that should meet nothing comes back with a small probability, at any range.
The logarithms add up to the scan's.

The same sum has an expectation and a variance under the pose itself, so that the *deficit*, expected minus
actual, says how badly the scan speaks against it, without any other pose to compare with: a right pose lacks
nothing but chance, a wrong one lacks several units a return.
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, qmc

from rpod_geometry.rays import cast
from rpod_pose.belief import Belief, contradicted
from rpod_pose.lidar.detection import LINEAR_STEPS, detection, expected_shares
from rpod_pose.lidar.scan_likelihood import (
    Assumptions,
    Draws,
    Judgement,
    Rays,
    agreed,
    judged,
    likeliest,
    log_likelihood,
)
from rpod_pose.lidar.scan_view import ScanView, SeenScan
from rpod_pose.registration.surface_model import SurfaceModel
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.lidar_search import ScanModelConfig, ScanVerdictConfig
from rpod_schemas.poses import pose_of

LEAST_DEVIATION = 3.0
"""Of a deficit, where nothing is left to chance."""
MARGIN = 3
"""Rows and columns beside a target that it may reach while a pose is sharpened."""
UNKNOWN_SIGMA_M = 0.05
"""Sigma of a range of a sensor that does not say it: pulsed LIDARs err by 2 to 5 cm."""

_ROUNDS, _SAMPLES, _ELITE = 4, 64, 10
_DRAWS = Draws(
    norm.ppf(qmc.Sobol(6, seed=1).random(_ROUNDS * _SAMPLES).clip(1e-3, 1.0 - 1e-3)).reshape(
        _ROUNDS, _SAMPLES, 6
    ),
    _ELITE,
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
    """Predicted returns that are lacking beyond what their echoes let expect."""

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
    """The statistics of a sensor's scans of a target.

    Args:
        config: what is assumed of the scans.
        verdict: when a pose explains one.
        view: the rays.
        surface: the target.
        sigma_range_m: what the sensor says of its range errors, 0 where it does not.
    """

    def __init__(
        self,
        config: ScanModelConfig,
        verdict: ScanVerdictConfig,
        view: ScanView,
        surface: SurfaceModel,
        *,
        sigma_range_m: float = 0.0,
    ) -> None:
        self._view, self._verdict = view, verdict
        self.sigma_range_m = config.sigma_range_m or sigma_range_m or UNKNOWN_SIGMA_M
        self._rays = Rays(view.grid.arrays, surface.faces, view.hits.range_m, view.hits.triangle)
        self._shares = expected_shares(config.surest_detection)
        self._assumed = _assumptions(config, self.sigma_range_m)
        self._pessimistic = _assumptions(verdict.pessimistic, self.sigma_range_m)

    def fit(self, seen: SeenScan, R: FloatArray, t: FloatArray) -> ScanFit:
        """Return how well the pose R, t of the target in the sensor explains a scan."""
        return _fit(judged(seen.range_m, R, t, self._rays, self._assumed))

    def agreement(self, seen: SeenScan, R: FloatArray, t: FloatArray) -> Agreement:
        """Return that part of ``fit`` alone, which takes half its time."""
        return Agreement(*agreed(seen.range_m, R, t, self._rays, self._assumed))

    def log_likelihood(self, seen: SeenScan, R: FloatArray, t: FloatArray) -> float:
        """Return that part of ``fit`` alone."""
        return float(log_likelihood(seen.range_m, R, t, self._rays, self._assumed))

    @property
    def expected_shares(self) -> tuple[float, FloatArray]:
        """Steps a unit of echo of a table, and the table: the share of rays that come back, for all scans."""
        return LINEAR_STEPS * self._assumed.least_range_m**2, self._shares

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
        less = _fit(judged(seen.range_m, R, t, self._rays, self._pessimistic))
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
        cast(self._view.grid, self._rays.faces[0], pose_of(R, t), out=hits)
        rows, columns = _around((seen.range_m > 0.0) | (hits.triangle >= 0))
        measured = np.ascontiguousarray(seen.range_m[rows, columns])
        rays = Rays(
            self._view.grid.block(rows, columns),
            self._rays.faces,
            np.empty(measured.shape, np.float32),
            np.empty(measured.shape, np.int32),
        )
        sharper: tuple[FloatArray, FloatArray] = likeliest(
            measured, R, t, rays, self._assumed, covariance, _DRAWS
        )
        return sharper


def _fit(told: Judgement) -> ScanFit:
    counts = told.agreeing, told.contrary, told.missing
    deficit = told.expected - told.log_likelihood
    return ScanFit(told.log_likelihood, deficit, sqrt(told.variance), Agreement(*counts))


def _assumptions(config: ScanModelConfig, sigma_range_m: float) -> Assumptions:
    return Assumptions(
        sigma_m=config.noise_scale * sigma_range_m,
        slack_m=config.slack_m,
        clutter_share=config.clutter_share,
        clutter_density=config.clutter_share / config.clutter_depth_m,
        least_range_m=config.least_range_m,
        detection=detection(config.surest_detection, config.clutter_share),
    )


def _around(rays: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return the rows and columns that hold some rays, and a margin."""
    row, column = (np.flatnonzero(rays.any(axis=axis)) for axis in (1, 0))
    return _widened(row), _widened(column)


def _widened(lines: NDArray[np.intp]) -> slice:
    return slice(max(0, lines[0] - MARGIN), lines[-1] + 1 + MARGIN)
