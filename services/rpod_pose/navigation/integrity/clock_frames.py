"""The clock of a slow sensor from all its frames in the memory, each beside the track of another sensor.

A filter of a slow sensor alone knows little: between two scans a second apart the target may accelerate. The
track of the other sensor knows where the target is at each scan. So the scan's pose d, less that of a track
without this sensor, is

    d = -tau (v, w) + b + n,

where tau is how late the scan's stamp is, (v, w) are velocity and rate, b are the errors that all scans share
(those of the track, of the scans' own blocks, and the declared ones of both mounts, clocks and ranges), and n
is the scan's own noise and that of the track. The weighted least squares estimate of tau with the prior of b
adds up the information of all scans. b does not average out: in a calm spin an angle of a mount is the same
as a clock, and the standard deviation of tau stays above that angle over the rate, however many scans there
are.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rpod_pose.navigation.filter import POSE, TWIST, FilterState, gate_nis, predict
from rpod_pose.navigation.filter.correction import pose_difference
from rpod_pose.navigation.history import Step
from rpod_pose.navigation.integrity.clocks import Late, Pair, clock_test
from rpod_pose.navigation.integrity.levels import Solution, declared_covariance
from rpod_pose.navigation.integrity.residuals import Statistic, periods_of
from rpod_pose.navigation.pose_measurement import shared_errors
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.config.estimator.integrity import IntegrityConfig
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.poses import rotation_matrix


@dataclass(frozen=True, eq=False)
class Apart:
    """How far a frame's pose is from the track of another sensor."""

    stamp_ns: int
    information: FloatArray
    """Information of the frame on (tau, b), shape (7, 7)."""
    weighted: FloatArray
    """Its product with what the frame tells of them, shape (7,)."""
    lasting: FloatArray
    """Covariance of the errors of the track and of the frame that last, shape (6, 6)."""


def apart_of(step: Step, without: FilterState, earlier: FilterState, config: FilterConfig) -> Apart | None:
    """Return how far a frame's pose is from the track without its sensor; None if it tells no clock.

    Before the motion is known, what a clock does would count as what all frames share.

    The error of this track lasts in part, and is new in part at each frame. So its covariance counts both in
    the noise of the frame and in what all frames share.

    The motion is that of the track some time before. The errors of its pose and of its velocity at one time
    agree, so that their product does not average out: with the motion of the same time, stamps look early.

    Args:
        step: the frame's measurement, and what the joint filter made of it.
        without: the filter without the frame's sensor, with no measurement that is newer than the frame.
        earlier: the same filter, as long before as it is known.
        config: the filter's configuration.
    """
    predicted, measured = step.predicted, replace(step.measurement, declared=None)
    without = predict(without, measured.stamp_ns, config)
    d = pose_difference(measured.T_chaser_target, without.T_chaser_target, predicted.alike)
    shared = shared_errors(measured, config, predicted.blocks)
    of_track = without.covariance[POSE, POSE]
    lasting = of_track + sum((by @ by.T for by in shared.sensitivities.values()), np.zeros((6, 6)))
    noise = predicted.alike.with_free_variance(
        shared.covariance + of_track, rotation_matrix(measured.T_chaser_target), 1.0
    )
    moving = predict(earlier, measured.stamp_ns, config)
    moved = -np.concatenate([moving.velocity_m_s, moving.rate_rad_s])
    if not moved @ np.linalg.solve(moving.covariance[TWIST, TWIST], moved) > gate_nis(moving, config):
        return None
    by = np.column_stack([moved, np.eye(6)])
    if not (np.isfinite(d).all() and np.isfinite(noise).all() and np.isfinite(lasting).all()):
        return None
    told = np.linalg.solve(noise, np.column_stack([by, d]))
    return Apart(measured.stamp_ns, by.T @ told[:, :7], by.T @ told[:, 7], lasting)


def clock_of_frames(
    pair: Pair,
    slow: str,
    frames: Sequence[Apart],
    *,
    estimate: FilterState,
    config: IntegrityConfig,
) -> tuple[Statistic, Late] | None:
    """Return the test of the clock by the frames of the slow sensor; None for a target that does not move.

    What all frames share is no larger than in the frame whose track is known best.

    Args:
        pair: the two sensors.
        slow: that of them whose frames are given.
        frames: its frames, at least one, in the order of their stamps.
        estimate: the estimate.
        config: declared errors, and the time within which frames count as one.
    """
    place_m, moving = estimate.T_chaser_target.translation, (estimate.velocity_m_s, estimate.rate_rad_s)
    moved = np.concatenate(moving)
    shared = min((each.lasting for each in frames), key=lambda lasting: float(moved @ lasting @ moved))
    lasting = shared + 2.0 * declared_covariance(config, place_m, *moving)
    span_s = (frames[-1].stamp_ns - frames[0].stamp_ns) / NANOSECONDS
    counted = periods_of(len(frames), span_s, config.tuning.correlated_s) / len(frames)
    information = counted * np.sum([each.information for each in frames], axis=0)
    weighted = counted * np.sum([each.weighted for each in frames], axis=0)
    information[1:, 1:] += np.linalg.inv(lasting)
    if not information[0, 0] > 0.0:
        return None
    covariance = np.linalg.inv(information)
    offset_s, sigma_s = float(covariance[0] @ weighted), float(np.sqrt(covariance[0, 0]))
    late = Late(offset_s if slow == pair.other else -offset_s, sigma_s)
    cause = f"; {late.describe(pair)}, or a mount is turned"
    name = f"{pair.one} and {pair.other} along the motion in {len(frames)} frames of {slow}"
    return Statistic(name, (offset_s / sigma_s) ** 2, 1, cause, config.tuning.clock_risk), late


@dataclass(frozen=True, eq=False)
class TwoClocks:
    """What the measurements tell of the clocks of two sensors."""

    stamp_ns: int
    """Stamp of the estimate at which it was told."""
    pair: Pair
    tests: tuple[Statistic, ...] = ()
    late: Late | None = None
    """Offset of the clocks, if it is the cause of the difference; None if nothing tells it."""

    @property
    def evidence(self) -> dict[str, float]:
        """The offset and its standard deviation, for ``estimate/integrity``."""
        return {} if self.late is None else self.late.evidence(self.pair)

    def solutions(self, estimate: FilterState, share: float) -> list[Solution]:
        """Return the solution under the hypothesis that the clock is off of the sensor that leads.

        The estimate follows the finer sensor. If that one's stamps are late, the target is ahead of the
        estimate by the offset times the motion, as surely as the offset is known.

        Args:
            estimate: the estimate.
            share: probability with which a sensor is wrong.
        """
        if self.late is None:
            return []
        moved = np.concatenate([estimate.velocity_m_s, estimate.rate_rad_s])
        covariance = estimate.covariance[POSE, POSE] + self.late.sigma_s**2 * np.outer(moved, moved)
        return [Solution(OTHER_CLOCK, abs(self.late.offset_s) * moved, covariance, share)]


OTHER_CLOCK = "with the other sensor's clock"
"""Name of that hypothesis."""


def two_clocks(
    pair: Pair,
    there: Sequence[FilterState],
    frames: Sequence[Apart],
    *,
    slow: str,
    estimate: FilterState,
    config: IntegrityConfig,
) -> TwoClocks:
    """Return what two filters, and the frames of the slow sensor, tell of the clocks of two sensors.

    Args:
        pair: the two sensors.
        there: the filters without the one and without the other, at the estimate's stamp.
        frames: frames of one sensor beside the track of the other; none where mounts are states, since the
            offset of the mounts contains that of the clocks.
        slow: the sensor of the frames.
        estimate: the estimate.
        config: declared errors.
    """
    without_one, without_other = there
    found = [clock_test(pair, without_one, without_other, estimate=estimate, config=config)]
    if frames:
        found.append(clock_of_frames(pair, slow, frames, estimate=estimate, config=config))
    known = [each for each in found if each is not None]
    surest = min((late for _, late in known), key=lambda late: late.sigma_s, default=None)
    return TwoClocks(estimate.stamp_ns, pair, tuple(test for test, _ in known), surest)
