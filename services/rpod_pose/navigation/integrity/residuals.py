"""Tests of a sensor's residuals: are they as large as the filter says, and is their mean zero?

A residual is the innovation y of a frame, whitened by its covariance S = L L^T: z = L^-1 y. It is normal with
unit covariance if sensor and filter are right. Errors of successive frames are correlated, so n frames count
as the number m of periods of ``correlated_s`` that they span. Then m times the mean of |z|^2 has at most the
tail of chi-squared with 6 m degrees of freedom, and m |mean of z|^2 at most that with 6, whatever the
correlation within a period is. The tests alert too seldom rather than too often.

Errors that last longer than a period do not average out. With two sensors they are in the innovations: the
track follows the errors of the one, the frame has those of the other. They are the considered states of the
filter, and what is declared of mount, clock and ranges of both sensors. With G_k what one standard deviation
of each of them does to z_k, the residuals have the covariance 1 + G G^T, and their mean has 1 / m + the mean
of G times its transpose. Both tests use these covariances (as a Schmidt-Kalman filter does, S. F. Schmidt
1966). For a single sensor what is declared does not count: its track has the same errors as its frames.

A stamp that is late by tau moves the measured pose by -tau (v, w), so that the mean of z is -tau L^-1 (v, w).
The least-squares estimate of tau shows whether the clock is the cause (Parkinson and Axelrad 1988 treat a
bias likewise).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import sqrt
from types import MappingProxyType

import numpy as np

from rpod_pose.navigation.dynamics.slewing import relied_on
from rpod_pose.navigation.filter import POSE, UNSEEN, FilterState, Innovation, separation_of
from rpod_pose.navigation.filter.blocks import placed
from rpod_pose.navigation.filter.prediction import turn_of_view_rad
from rpod_pose.navigation.filter.state import MOTION
from rpod_pose.navigation.integrity.levels import chi2_limit, declared_covariance, declared_errors
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.integrity import IntegrityConfig
from rpod_schemas.poses import rotation_matrix

EXPLAINED = 0.5
"""Least share of a bias that a clock must explain to be named as the cause. Hand: more than all other causes
together."""
DECLARED = "declared errors of two sensors"
"""Name of the lasting errors of mounts, clocks and ranges, which count only if several sensors measure."""

APART = (
    "; mount, clock or ranges of this sensor or of another one are wrong: compare them with "
    "rpod driver check --against"
)
"""Causes of large residuals of one of several sensors, with the remedy."""
LIVELY = (
    "; stamps are irregular, or the target moves more than filter.acceleration_density_m2_s3 and "
    "filter.angular_acceleration_density_rad2_s3 allow"
)
"""Causes of large residuals of a single sensor."""

Lasting = Mapping[str, FloatArray]
"""What one standard deviation of each lasting error does to an innovation, shape (6, n), by their name."""
NONE_LASTS: Lasting = MappingProxyType({})
"""No lasting errors."""


@dataclass(frozen=True, eq=False)
class Residual:
    """A whitened innovation."""

    stamp_ns: int
    z: FloatArray
    """Whitened innovation of (dp, dtheta), in standard deviations, shape (6,)."""
    late: FloatArray
    """Derivative of z with respect to the delay of the stamp, 1/s, shape (6,)."""
    lasting: Lasting = field(default_factory=dict)
    """What lasting errors do to z."""
    relied: str = ""
    """What the prediction relied on beside the sensors, for the operator."""

    def delayed_square(self) -> float:
        """Return the square of z, with the lasting errors of two sensors, at the likeliest delay.

        A pose that the gate refuses for its stamp alone is within the gate by this square.
        """
        G = _lasting([self], several=True)
        product = _Product(1.0, G)
        square, information = product.of(self.z, self.z), product.of(self.late, self.late)
        return square - (product.of(self.late, self.z) ** 2 / information if information > 0.0 else 0.0)


@dataclass(frozen=True)
class Statistic:
    """A test statistic, which has the distribution of chi-squared if sensor and filter are right."""

    name: str
    """Tested quantity, in words."""
    value: float
    """Value of the statistic, to be compared with chi-squared."""
    dof: float
    """Degrees of freedom."""
    cause: str = ""
    """Likely cause, for the operator."""
    least_risk: float = 0.0
    """Least probability at which it may fail by chance, of a test with few independent looks an hour."""

    def exceeds_risk(self, risk: float) -> bool:
        """Return whether the statistic is above the limit that it exceeds by chance with ``risk``."""
        return not self.value <= self._limit(risk)

    def describe(self, risk: float) -> str:
        """Return the test in words, with its figures."""
        return f"{self.name}: chi squared {self.value:.1f}, limit {self._limit(risk):.1f}{self.cause}"

    def _limit(self, risk: float) -> float:
        return chi2_limit(max(risk, self.least_risk), self.dof)


def separation_test(
    name: str, one: FilterState, other: FilterState, config: IntegrityConfig | None = None
) -> Statistic:
    """Return the test whether two solutions differ by more than their covariances together allow.

    Solutions that share measurements differ by less than that, so the test alerts too seldom.

    Args:
        name: what is tested, in words.
        one: a solution.
        other: another one, at the same stamp.
        config: declared errors, which solutions of two sensors do not share; None for those of one sensor.
    """
    apart = separation_of(one, other)
    covariance = one.covariance[POSE, POSE] + other.covariance[POSE, POSE]
    if config is not None:
        place_m = one.T_chaser_target.translation
        covariance = covariance + 2.0 * declared_covariance(config, place_m, one.velocity_m_s, one.rate_rad_s)
    covariance = one.alike.with_free_variance(covariance, rotation_matrix(one.T_chaser_target), 1.0)
    return Statistic(name, float(apart @ np.linalg.solve(covariance, apart)), one.alike.dof)


def lasting_errors(predicted: FilterState, found: Innovation, config: IntegrityConfig) -> Lasting:
    """Return what errors that last longer than a period of the tests do to an innovation.

    A considered state of which a share r is left after a period counts by the root of r: the errors of two
    successive periods then have the right covariance, those of later ones a larger one.

    Args:
        predicted: prediction to the measurement's stamp.
        found: the innovation.
        config: declared errors, and the period.
    """
    period_s = config.tuning.correlated_s
    turn_rad = turn_of_view_rad(predicted, period_s)
    lasting: dict[str, FloatArray] = {}
    for block, place in placed(predicted.blocks, MOTION.stop):
        if block.considered and block.name != UNSEEN:
            share = block.kept(period_s, turn_rad)
            lasting[block.name] = sqrt(share) * found.cross[:, place] / block.sigma
    moving = (predicted.velocity_m_s, predicted.rate_rad_s)
    lasting[DECLARED] = sqrt(2.0) * declared_errors(config, predicted.T_chaser_target.translation, *moving)
    return lasting


def residual_of(
    predicted: FilterState, found: Innovation, stamp_ns: int, lasting: Lasting = NONE_LASTS
) -> Residual | None:
    """Return the residual of a measurement against the prediction to its stamp; None if it is not finite."""
    y, S = found.difference, found.covariance
    if not (np.isfinite(y).all() and np.isfinite(S).all()):
        return None
    try:
        L = np.linalg.cholesky(S)
    except np.linalg.LinAlgError:
        return None
    twist = np.concatenate([predicted.velocity_m_s, predicted.rate_rad_s])
    white: FloatArray = np.linalg.solve(L, np.column_stack([y, -twist, *lasting.values()])).astype(np.float64)
    ends = np.cumsum([2, *(each.shape[1] for each in lasting.values())])
    parts = dict(zip(lasting, np.split(white, ends[:-1], axis=1)[1:], strict=True))
    return Residual(stamp_ns, white[:, 0], white[:, 1], parts, relied_on(predicted))


def recent(residuals: Sequence[Residual], newest_ns: int, window_s: float) -> tuple[Residual, ...]:
    """Return the residuals of the last ``window_s`` seconds, in the order of their stamps."""
    kept = (each for each in residuals if newest_ns - each.stamp_ns <= window_s * 1e9)
    return tuple(sorted(kept, key=lambda each: each.stamp_ns))


def residual_tests(
    sensor: str, residuals: Sequence[Residual], *, dof: int, correlated_s: float, several: bool = False
) -> tuple[tuple[Statistic, ...], dict[str, float]]:
    """Return the tests of a sensor's residuals, and the estimate of its clock's offset as evidence.

    Args:
        sensor: name of the sensor.
        residuals: its residuals in the window, at least one.
        dof: degrees of freedom of a pose: 6, less with a free axis.
        correlated_s: time within which residuals count as one.
        several: whether several sensors measure, so that their declared errors are in the residuals.
    """
    z = np.array([each.z for each in residuals])
    late = np.array([each.late for each in residuals])
    span_s = (residuals[-1].stamp_ns - residuals[0].stamp_ns) * 1e-9
    periods = periods_of(len(z), span_s, correlated_s)
    G = _lasting(residuals, several=several)
    shared = G.mean(axis=0)
    of_mean = np.eye(6) / periods + shared @ shared.T

    def biased(mean: FloatArray) -> float:
        return float(mean @ np.linalg.solve(of_mean, mean))

    bias = biased(z.mean(axis=0))
    product = _Product(periods / len(z), G)
    square = product.of(z, z)
    information = product.of(late, late)
    evidence, of_size, of_bias = {}, "", ""
    if information > 0.0:
        offset_s = product.of(late, z) / information
        sigma_s = information**-0.5
        evidence = {f"{sensor}_stamps_late_s": offset_s, f"{sensor}_stamps_late_sigma_s": sigma_s}
        text = f"; stamps that are {offset_s:.3f} s late (sigma {sigma_s:.3f} s) explain "
        of_size = _clock(text, square, square - offset_s**2 * information)
        of_bias = _clock(text, bias, biased((z - offset_s * late).mean(axis=0)))
    usual, relied = APART if several else LIVELY, residuals[-1].relied
    size = Statistic(f"{sensor}: size of its residuals", square, dof * periods, (of_size or usual) + relied)
    mean = Statistic(f"{sensor}: mean of its residuals", bias, dof, (of_bias or usual) + relied)
    return (size, mean), evidence


def _clock(text: str, value: float, rest: float) -> str:
    """Return a clock as the cause of a test's value, of which it leaves a rest; empty if it leaves most."""
    return f"{text}{1.0 - rest / value:.0%}" if value > 0.0 and rest < (1.0 - EXPLAINED) * value else ""


def _lasting(residuals: Sequence[Residual], *, several: bool) -> FloatArray:
    """Return what all lasting errors do to each of N residuals, shape (N, 6, n)."""
    sizes = {name: each.shape[1] for residual in residuals for name, each in residual.lasting.items()}
    if not several:
        sizes.pop(DECLARED, None)
    G = np.zeros((len(residuals), 6, sum(sizes.values())))
    first = 0
    for name, size in sizes.items():
        for k, residual in enumerate(residuals):
            if name in residual.lasting:
                G[k, :, first : first + size] = residual.lasting[name]
        first += size
    return G


class _Product:
    """The product of two series a, b of whitened vectors, a^T (1 + G G^T)^-1 b, shape (N, 6) each.

    It is computed with the inverse of (1 + G^T G), which is small (M. A. Woodbury 1950).

    Args:
        counted: number of independent frames as which one frame counts.
        G: what one standard deviation of each lasting error does to each frame, shape (N, 6, n).
    """

    def __init__(self, counted: float, G: FloatArray) -> None:
        self._counted, self._G = counted, G.reshape(G.shape[0] * G.shape[1], G.shape[2])
        self._inner = np.eye(G.shape[2]) + counted * self._G.T @ self._G

    def of(self, a: FloatArray, b: FloatArray) -> float:
        """Return the product of two series."""
        left, right = (self._counted * self._G.T @ each.ravel() for each in (a, b))
        return float(self._counted * a.ravel() @ b.ravel() - left @ np.linalg.solve(self._inner, right))


def periods_of(count: int, span_s: float, correlated_s: float) -> float:
    """Return the number of independent frames as which ``count`` frames in a span of time count."""
    return min(float(count), 1.0 + (span_s / correlated_s if correlated_s else np.inf))
