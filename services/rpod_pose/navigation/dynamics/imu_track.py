"""Measurements of the chaser's IMU, integrated once, so that any step is a difference of two integrals.

With G the attitude of the chaser in axes that are at rest, dG/dt = G [w]x for the measured rate w. The turn
of a step from 0 to 1 is G1^T G0. An error d of the bias turns it by G1^T (S1 - S0) d to first order, where S
is the integral of G. The measured specific force f is treated in the same way: its integrals are those of
G f, and their derivatives with respect to the bias are the integrals of -G. If a star tracker measures the
attitude, the rates are corrected by the estimated bias of the gyro (``gyro_bias``). The bias of a step is
then the error of this estimate.
"""

from bisect import bisect_right
from dataclasses import dataclass, replace

import numpy as np

from rpod_pose.navigation.dynamics.chaser import ChaserStep, pushed
from rpod_pose.navigation.dynamics.gyro_bias import GyroBias
from rpod_pose.navigation.filter.rotations import exponential
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import ImuReading

_GAP_S = 0.1
"""Longest time between two readings for which the rotation between them is known. Hand: a spacecraft's
attitude control reacts within some tenths of a second."""
_KEPT_S = 300.0
"""Time for which readings are kept. Numerics: memory; no track coasts for longer."""
_RATE_S = 0.2
"""Time before a stamp from whose readings the rate at the stamp is estimated. Physics: its noise is then 5
times the angular random walk over a second, and attitude control changes the rate little in this time."""


@dataclass(frozen=True, eq=False, slots=True)
class _Sum:
    """Integrals up to a stamp; ``speed_m_s`` and ``way_m`` are those of the specific force."""

    stamp_ns: int
    rate_rad_s: FloatArray
    """The measured value."""
    force_m_s2: FloatArray
    G: FloatArray
    S: FloatArray
    SS: FloatArray
    """Integral of S."""
    speed_m_s: FloatArray
    way_m: FloatArray
    variance: float
    """Variance of the turn about each axis."""
    speed_variance: float
    """Variance of the speed along each axis."""
    density: float
    """Rise of the variance of the turn in a second, which goes on until the next reading."""
    force_density: float
    """The same of the speed."""
    unknown: FloatArray
    """``pushed`` at this stamp of the parts in which nothing is measured, shape (3,)."""
    angle_rad: FloatArray
    """Integral of the rate without the known bias, component by component, for its mean."""
    R_orbit_chaser: FloatArray | None
    bias: GyroBias


class ImuTrack:
    """Readings of the chaser's IMU in the order of their stamps, and their integrals.

    A step uses no readings after its end. So its result does not depend on when it is computed, once all
    readings up to its end have arrived. After the last reading its rate is assumed; more than 0.1 s after it,
    the rotation counts as unknown.

    Args:
        noise_rad_sqrt_s: angular random walk of a gyro whose readings do not state their variance.
        force_noise_m_s_sqrt_s: velocity random walk of an accelerometer whose readings do not state theirs.
        R_orbit_chaser: attitude in the orbital frame, used if readings state none; None if it is unknown.
        orbit_rate_rad_s: rate of the orbit; None if attitudes are not used to estimate the gyro's bias.
        bias_sigma_rad_s: standard deviation of the gyro's bias before any attitude.
        bias_walk_rad_s_sqrt_s: random walk of the gyro's bias.
    """

    def __init__(
        self,
        noise_rad_sqrt_s: float = 0.0,
        R_orbit_chaser: FloatArray | None = None,
        *,
        force_noise_m_s_sqrt_s: float = 0.0,
        orbit_rate_rad_s: float | None = None,
        bias_sigma_rad_s: float = 0.0,
        bias_walk_rad_s_sqrt_s: float = 0.0,
    ) -> None:
        self._noise, self._walk = noise_rad_sqrt_s**2, bias_walk_rad_s_sqrt_s**2
        self._force_noise = force_noise_m_s_sqrt_s**2
        self._attitude, self._orbit_rate_rad_s = R_orbit_chaser, orbit_rate_rad_s
        self.bias_sigma_rad_s = bias_sigma_rad_s
        """Standard deviation of the gyro's bias before any attitude."""
        self._unknown = GyroBias.unknown(bias_sigma_rad_s)
        self._begin_ns = 0
        self._sums: list[_Sum] = []

    def bias_at(self, stamp_ns: int) -> GyroBias:
        """Return the estimate of the gyro's bias from the attitudes of the star tracker up to a stamp."""
        return self._at(stamp_ns).bias if self._sums else self._unknown

    def covers(self, stamp_ns: int) -> bool:
        """Return whether all readings up to a stamp have arrived, if their period stays the same."""
        if len(self._sums) < 2:
            return False
        newest_ns = self._sums[-1].stamp_ns
        return 2 * newest_ns - self._sums[-2].stamp_ns > stamp_ns

    def forget(self) -> None:
        """Forget all readings and the estimate of the bias, for example after a clock was set back."""
        self._sums.clear()

    def take(self, reading: ImuReading) -> bool:
        """Add a reading and return True; if it is not newer than all before, ignore it and return False."""
        last = self._sums[-1] if self._sums else None
        if last is not None and reading.stamp_ns <= last.stamp_ns:
            return False
        attitude = self._attitude if reading.R_orbit_chaser is None else reading.R_orbit_chaser.as_matrix()
        force = np.zeros(3) if reading.force_m_s2 is None else reading.force_m_s2
        if last is None:
            self._begin_ns = reading.stamp_ns
            nothing, none = np.zeros((3, 3)), np.zeros(3)
            found = _Sum(
                reading.stamp_ns, reading.rate_rad_s, force, np.eye(3), nothing, nothing, none, none, 0.0,
                0.0, self._noise, self._force_noise, none, none, attitude, self._unknown,
            )  # fmt: skip
        else:
            step_s = (reading.stamp_ns - last.stamp_ns) * 1e-9
            density = reading.rate_variance * step_s if reading.rate_variance else self._noise
            force_density = reading.force_variance * step_s if reading.force_variance else self._force_noise
            found = _extended(
                last,
                stamp_ns=reading.stamp_ns,
                rate_rad_s=reading.rate_rad_s,
                force_m_s2=force,
                density=density,
                force_density=force_density,
                attitude=attitude,
            )
            bias = last.bias.after(
                found.S - last.S, step_s=step_s, noise_rad2_s=density, walk_rad2_s3=self._walk
            )
            found = replace(found, bias=bias)
        self._sums.append(self._with_attitude(found, reading))
        self._prune()
        return True

    def _with_attitude(self, found: _Sum, reading: ImuReading) -> _Sum:
        """Return the integrals with the bias corrected by the reading's attitude, if it has one."""
        if self._orbit_rate_rad_s is None or reading.R_orbit_chaser is None or not reading.attitude_variance:
            return found
        angle_rad = self._orbit_rate_rad_s * (reading.stamp_ns - self._begin_ns) * 1e-9
        measured = exponential(np.array([0.0, 0.0, angle_rad])) @ reading.R_orbit_chaser.as_matrix()
        return replace(found, bias=found.bias.corrected(measured, found.G, reading.attitude_variance))

    def _prune(self) -> None:
        oldest_ns = self._sums[-1].stamp_ns - round(_KEPT_S * 1e9)
        if len(self._sums) % 4096 == 0:
            self._sums = self._sums[bisect_right(self._sums, oldest_ns, key=lambda each: each.stamp_ns) :]

    def step(self, begin_ns: int, end_ns: int) -> ChaserStep:
        """Return the motion between two stamps, ns."""
        if not self._sums:
            nothing, none = np.zeros((3, 3)), np.zeros(3)
            step_s = (end_ns - begin_ns) * 1e-9
            return ChaserStep(
                np.eye(3), nothing, none, none, 0.0, pushed(0.0, step_s, step_s), none, none,
                nothing, nothing, self._attitude,
            )  # fmt: skip
        a, b = self._until(begin_ns, end_ns), self._at(end_ns)
        step_s = (end_ns - begin_ns) * 1e-9
        back = a.G.T
        kept = 1.0
        if b.bias.variance < a.bias.variance:
            kept = b.bias.variance / a.bias.variance
        return ChaserStep(
            turn=b.G.T @ a.G,
            turn_by_bias=b.G.T @ (b.S - a.S),
            rate_before_rad_s=self._mean_rate(a, end_ns),
            rate_after_rad_s=self._mean_rate(b, end_ns),
            turn_variance=max(b.variance - a.variance, 0.0),
            unknown=np.maximum(b.unknown - _later(a.unknown, step_s), 0.0),
            speed_m_s=back @ (b.speed_m_s - a.speed_m_s),
            way_m=back @ (b.way_m - a.way_m - step_s * a.speed_m_s),
            speed_by_bias=-back @ (b.S - a.S),
            way_by_bias=-back @ (b.SS - a.SS - step_s * a.S),
            R_orbit_chaser=a.R_orbit_chaser,
            bias_kept=kept,
            bias_noise=b.bias.variance * (1.0 - kept),
            force_noise=max(b.speed_variance - a.speed_variance, 0.0)
            * np.array([step_s**2 / 3.0, step_s / 2.0, 1.0]),
            rate_variance=self._rate_variance(b),
        )

    def turn(self, begin_ns: int, end_ns: int) -> FloatArray:
        """Return the turn of a step alone, shape (3, 3)."""
        return self._at(end_ns).G.T @ self._until(begin_ns, end_ns).G if self._sums else np.eye(3)

    def _at(self, stamp_ns: int) -> _Sum:
        """Return the integrals at any stamp, by the readings up to it."""
        place = bisect_right(self._sums, stamp_ns, key=lambda each: each.stamp_ns)
        before = self._sums[max(place - 1, 0)]
        if before.stamp_ns == stamp_ns:
            return before
        return _extended(
            before,
            stamp_ns=stamp_ns,
            rate_rad_s=before.rate_rad_s,
            force_m_s2=before.force_m_s2,
            density=before.density,
            force_density=before.force_density,
            attitude=before.R_orbit_chaser,
        )

    def _until(self, stamp_ns: int, end_ns: int) -> _Sum:
        """Return the integrals at a stamp for a step up to an end, by the readings up to this end.

        In a gap that ends within the step, rate and force are those between its two readings. So a step at
        the end of the gap does not have all that the chaser turned in the gap, and its rate is the present
        one. Variance and bias, and how much is unknown, are those of ``_at``.
        """
        found, place = self._at(stamp_ns), bisect_right(self._sums, stamp_ns, key=lambda each: each.stamp_ns)
        if not 0 < place < len(self._sums) or self._sums[place].stamp_ns > end_ns:
            return found
        last, ends = self._sums[place - 1], self._sums[place]
        gap_ns = ends.stamp_ns - last.stamp_ns
        if gap_ns <= round(_GAP_S * 1e9):
            return found
        share = (stamp_ns - last.stamp_ns) / gap_ns
        between = _extended(
            ends,
            stamp_ns=stamp_ns,
            rate_rad_s=last.rate_rad_s + share * (ends.rate_rad_s - last.rate_rad_s),
            force_m_s2=last.force_m_s2 + share * (ends.force_m_s2 - last.force_m_s2),
            density=found.density,
            force_density=found.force_density,
            attitude=found.R_orbit_chaser,
        )
        return replace(
            between,
            bias=found.bias,
            unknown=found.unknown,
            variance=found.variance,
            speed_variance=found.speed_variance,
        )

    def _mean_rate(self, at: _Sum, end_ns: int) -> FloatArray:
        """Return the rate at a stamp, extrapolated linearly from two means over a short time before it.

        Args:
            at: integrals at the stamp.
            end_ns: end of the step, up to which readings are used.
        """
        stamp_ns = at.stamp_ns - round(_RATE_S * 1e9)
        if stamp_ns <= self._sums[0].stamp_ns:
            return at.rate_rad_s - at.bias.bias_rad_s
        before = self._until(stamp_ns, end_ns)
        middle = self._until(at.stamp_ns - round(0.5e9 * _RATE_S), end_ns)
        late = (at.angle_rad - middle.angle_rad) / (0.5 * _RATE_S)
        early = (middle.angle_rad - before.angle_rad) / (0.5 * _RATE_S)
        # the means are those at 3/4 and 1/4 of this time before the stamp
        return 1.5 * late - 0.5 * early

    def _rate_variance(self, at: _Sum) -> float:
        """Return the variance about each axis of ``_mean_rate``, by the noise of the gyro, (rad/s)^2."""
        before = self._at(at.stamp_ns - round(_RATE_S * 1e9))
        density = max(at.variance - before.variance, 0.0) / _RATE_S
        return (1.5**2 + 0.5**2) * density / (0.5 * _RATE_S)


def _extended(
    last: _Sum,
    *,
    stamp_ns: int,
    rate_rad_s: FloatArray,
    force_m_s2: FloatArray,
    density: float,
    force_density: float,
    attitude: FloatArray | None,
) -> _Sum:
    """Return the integrals at another stamp, later or earlier, with the mean of the readings at both ends."""
    step_s = (stamp_ns - last.stamp_ns) * 1e-9
    mean_rad_s = 0.5 * (last.rate_rad_s + rate_rad_s) - last.bias.bias_rad_s
    G = last.G @ exponential(mean_rad_s * step_s)
    middle = 0.5 * (last.G + G)
    force = 0.5 * (last.G @ last.force_m_s2 + G @ force_m_s2)
    return _Sum(
        stamp_ns=stamp_ns,
        rate_rad_s=rate_rad_s,
        force_m_s2=force_m_s2,
        G=G,
        S=last.S + step_s * middle,
        SS=last.SS + step_s * last.S + 0.5 * step_s**2 * middle,
        speed_m_s=last.speed_m_s + step_s * force,
        way_m=last.way_m + step_s * last.speed_m_s + 0.5 * step_s**2 * force,
        variance=last.variance + abs(step_s) * density,
        speed_variance=last.speed_variance + abs(step_s) * force_density,
        density=density,
        force_density=force_density,
        unknown=_later(last.unknown, step_s)
        + (pushed(0.0, step_s, step_s) if abs(step_s) > _GAP_S else np.zeros(3)),
        angle_rad=last.angle_rad + step_s * mean_rad_s,
        R_orbit_chaser=attitude,
        bias=last.bias,
    )


def _later(found: FloatArray, step_s: float) -> FloatArray:
    """Return ``pushed`` of the same parts at a later time, shape (3,)."""
    way, mixed, speed = found
    return np.array([way + 2.0 * step_s * mixed + step_s**2 * speed, mixed + step_s * speed, speed])
