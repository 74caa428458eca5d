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

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import erf
from scipy.stats import norm, qmc

from rpod_estimator.tracking.scan_view import ScanView, SeenScan
from rpod_estimator.tracking.signed_distance import turned
from rpod_estimator.tracking.surface_model import SurfaceModel
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.lidar_search import ScanModelConfig, ScanVerdictConfig
from rpod_schemas.poses import pose_of
from rpod_sim_sensor.geometry import cast, cast_pose

OUTLIER_FACTOR = 4.0
"""Sigma of outliers over that of the others (2015 paper, section 3.2)."""
STEEPEST = 0.05
"""Cosine of incidence below which a surface's slack along the ray grows no more."""
HIT_MEAN, HIT_VARIANCE = 0.677, 1.03
"""Of minus the log likelihood of a range error, without 0.5 log(2 pi sigma^2): of the mixture with 6 % of
outliers, integrated numerically."""
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
class ScanFit:
    """How well a pose explains a scan."""

    log_likelihood: float
    deficit: float
    """Expected minus actual log likelihood."""
    deviation: float
    """Standard deviation of the deficit under the pose."""
    agreeing: int
    """Returns where one was predicted, at the predicted range."""
    contrary: int
    """Returns where none was predicted, or at another range."""
    missing: float
    """Predicted returns that are lacking beyond what P_D lets expect."""

    @property
    def explained_share(self) -> float:
        """Of the rays where scan or model say "return", the share that agrees; NaN where there is none."""
        asked = self.agreeing + self.contrary + self.missing
        return self.agreeing / asked if asked else float("nan")


class ScanModel:
    """The statistics of a sensor's scans of a target."""

    def __init__(
        self, config: ScanModelConfig, verdict: ScanVerdictConfig, view: ScanView, surface: SurfaceModel
    ) -> None:
        self._view, self._faces, self._verdict = view, surface.faces, verdict
        self.detection = detection_table(config)
        self._chances, self._noise = _chances(config), _noise(config)
        self._pessimistic = _chances(verdict.pessimistic), _noise(verdict.pessimistic)

    def fit(self, seen: SeenScan, R: FloatArray, t: FloatArray) -> ScanFit:
        """Return how well the pose R, t of the target in the sensor explains a scan."""
        return self._fit(seen, R, t, self._chances, self._noise)

    def doubt(self, seen: SeenScan, R: FloatArray, t: FloatArray, fit: ScanFit) -> str:
        """Return why a pose does not explain a scan, whose fit is known; empty if it does."""
        if self._content(fit, seen.returns) or self._content(
            self._fit(seen, R, t, *self._pessimistic), seen.returns
        ):
            return ""
        return (
            f"does not explain the scan: of {seen.returns} returns {fit.contrary} contradict the pose, "
            f"{fit.missing:.0f} more are missing"
        )

    def _content(self, fit: ScanFit, returns: int) -> bool:
        verdict = self._verdict
        most = verdict.max_deficit * max(fit.deviation, LEAST_DEVIATION)
        contrary = verdict.contrary_share + 2.0 * sqrt(verdict.contrary_share / returns)
        return (
            fit.deficit <= most + verdict.max_deficit_per_return * returns
            and fit.explained_share >= 1.0 - contrary
        )

    def _fit(
        self,
        seen: SeenScan,
        R: FloatArray,
        t: FloatArray,
        chances: tuple[float, FloatArray],
        noise: tuple[float, ...],
    ) -> ScanFit:
        hits = self._view.hits
        actual, expected, variance, agreeing, contrary, missed, expected_missed = likelihood(
            seen.range_m,
            R,
            t,
            self._view.grid.arrays,
            self._faces,
            chances,
            noise,
            hits.range_m,
            hits.triangle,
        )
        missing = max(0.0, missed - expected_missed - sqrt(expected_missed))
        return ScanFit(actual, expected - actual, sqrt(variance), agreeing, contrary, missing)

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
            R,
            t,
            self._view.grid.block(rows, columns),
            self._faces,
            self._chances,
            self._noise,
            covariance,
            _DRAWS,
            np.empty(measured.shape, np.float32),
            np.empty(measured.shape, np.int32),
        )
        return sharper


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


@njit(cache=True, nogil=True, error_model="numpy")
def likelihood(measured, R, t, grid, faces, chances, noise, range_m, owner):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Return actual, expected, variance, agreeing, contrary, missed and expected missed (``ScanFit``).

    Args:
        measured: range of each ray, 0 where no return, shape (rows, columns), m.
        R: of the target in the sensor, shape (3, 3).
        t: of the target in the sensor, shape (3,), m.
        grid: ``RayGrid.arrays``.
        faces: ``SurfaceModel.faces``.
        chances: ``_chances``.
        noise: sigma, slack, outlier share, clutter share, clutter density a metre.
        range_m: buffer for the predicted ranges, shape (rows, columns).
        owner: buffer for the predicted faces, shape (rows, columns).
    """
    triangles, normals, _, reflectivity = faces
    steps, table = chances
    sigma, slack, outliers, clutter, density = noise
    rays = grid[0]
    cast_pose(grid, triangles, R, t, True, range_m, owner)
    log_density, log_clear = np.log(density), np.log(1.0 - clutter)
    actual, expected, variance, missed, expected_missed = 0.0, 0.0, 0.0, 0.0, 0.0
    agreeing, contrary = 0, 0
    for i in range(range_m.shape[0]):
        for j in range(range_m.shape[1]):
            face, m = owner[i, j], measured[i, j]
            if face < 0:
                if m > 0.0:
                    actual += log_density - log_clear
                    contrary += 1
                continue
            dx, dy, dz = rays[0, i, j], rays[1, i, j], rays[2, i, j]
            cosine = 0.0
            for k in range(3):
                cosine -= normals[face, k] * (R[0, k] * dx + R[1, k] * dy + R[2, k] * dz)
            r = np.float64(range_m[i, j])
            echo = cosine * reflectivity[face] / (r * r)
            rung = min(int(echo * steps), table.shape[1] - 1)
            p, log_p, miss = table[0, rung], table[1, rung], table[2, rung]
            lateral = slack / max(cosine, STEEPEST)
            narrow = sigma * sigma + lateral * lateral
            hit = log_p - 0.5 * np.log(2.0 * np.pi * narrow) - HIT_MEAN
            expected += p * hit + (1.0 - p) * miss - log_clear
            variance += p * (1.0 - p) * (hit - miss) ** 2 + HIT_VARIANCE * p
            expected_missed += 1.0 - p
            if m > 0.0:
                e2 = (m - r) * (m - r)
                wide = OUTLIER_FACTOR**2 * sigma * sigma + lateral * lateral
                near = (1.0 - outliers) * np.exp(-0.5 * e2 / narrow) / np.sqrt(2.0 * np.pi * narrow)
                near += outliers * np.exp(-0.5 * e2 / wide) / np.sqrt(2.0 * np.pi * wide)
                actual += np.log(p * near + density) - log_clear
                if e2 < 16.0 * wide:
                    agreeing += 1
                else:
                    contrary += 1
            else:
                actual += miss - log_clear
                missed += 1.0
    return actual, expected, variance, agreeing, contrary, missed, expected_missed


@njit(cache=True, nogil=True, error_model="numpy")
def likeliest(  # type: ignore[no-untyped-def]  # noqa: PLR0917
    measured, R, t, grid, faces, chances, noise, covariance, draws, range_m, owner
):
    """Return ``ScanModel.sharpen``; draws are standard normal, shape (rounds, samples, 6)."""
    best_R, best_t, spread = R, t, covariance.copy()
    best = likelihood(measured, R, t, grid, faces, chances, noise, range_m, owner)[0]
    steps, scores = np.empty(draws.shape[1:]), np.empty(draws.shape[1])
    for number in range(draws.shape[0]):
        root = np.linalg.cholesky(spread + 1e-12 * np.eye(6))
        centre_R, centre_t = best_R, best_t
        for n in range(draws.shape[1]):
            steps[n] = root @ draws[number, n]
            moved_t, moved_R = centre_t + centre_R @ steps[n, :3], turned(centre_R, steps[n, 3:])
            sums = likelihood(measured, moved_R, moved_t, grid, faces, chances, noise, range_m, owner)
            scores[n] = sums[0]
            if scores[n] > best:
                best, best_R, best_t = scores[n], moved_R, moved_t
        elite = steps[np.argsort(-scores)[:_ELITE]]
        middle = np.zeros(6)
        for row in elite:
            middle += row / _ELITE
        spread = np.zeros((6, 6))
        for row in elite:
            spread += np.outer(row - middle, row - middle) / _ELITE
    return best_R, best_t
