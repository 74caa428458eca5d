"""Methods for scans whose ranges have another noise than the sensor states.

A method assumes the noise that the sensor states. If it is too small, right poses are refused, since their
returns seem to contradict them, and the covariance of others is too small. The residuals at the pose found
show the noise, since neighbouring returns do not share it (``neighbour_residuals``). The method is then
repeated with the noise that they show.

A smaller noise than the stated one is not assumed: a sensor may state with it the errors that the returns of
a surface share. It is in the evidence where the sensor states none.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import log2, sqrt
from typing import Generic, TypeVar

from scipy.spatial.transform import RigidTransform

from rpod_pose.belief import NOISE_M, STATED_NOISE_M
from rpod_pose.lidar.global_search import GlobalSearch
from rpod_pose.lidar.projective_icp import ProjectiveIcp
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.ports import Acquisition, Registration
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import LidarScan

STEPS = 3
"""Largest number of repetitions. Numerics: a budget; the first one mostly finds the noise."""
MOST = 8
"""Largest number of factors sqrt(2) on the noise. Numerics: 16 times; with more, scans are refused."""

MethodT = TypeVar("MethodT", ProjectiveIcp, GlobalSearch)


class _AtNoise(Generic[MethodT]):
    """A method for the stated noise, and the same one for larger noise.

    Args:
        make: function that returns the method for a pattern.
        pattern: directions of the sensor's rays, and the noise that it states.
    """

    def __init__(self, make: Callable[[ScanPattern], MethodT], pattern: ScanPattern) -> None:
        self._make: Callable[[ScanPattern], MethodT] = make
        self._pattern = pattern
        self._methods: dict[int, MethodT] = {0: make(pattern)}

    def _at(self, step: int) -> MethodT:
        """Return the method for the assumed noise times a power of sqrt(2)."""
        if step not in self._methods:
            sigma_m = self._pattern.assumed_sigma_m * sqrt(2.0) ** step
            self._methods[step] = self._make(replace(self._pattern, sigma_range_m=sigma_m))
        return self._methods[step]

    def _found(self, call: Callable[[MethodT], Acquisition]) -> Acquisition:
        """Return the result of a call; its evidence has the noise that the scan shows, if not as assumed."""
        first, step = call(self._at(0)), 0
        found, noise, stated_m = first, 1.0, self._pattern.assumed_sigma_m
        for _ in range(STEPS):
            misfit = found.registration.misfit
            noise = 1.0 if misfit is None else misfit.noise
            if noise <= 1.0 or step == MOST:
                break
            step = min(step + max(1, round(2.0 * log2(noise))), MOST)
            found = call(self._at(step))
        if step == 0 and 0.0 < noise < 1.0 and not self._pattern.sigma_range_m:
            return _told(first, stated_m * noise, stated_m)
        if step == 0 or not found.registration.continues_track:
            return first
        return _told(found, stated_m * sqrt(2.0) ** step, stated_m)


class NoisyScanTracker(_AtNoise[ProjectiveIcp]):
    """Registers scans with the noise that they show: ports.Tracker[LidarScan]; arguments as above."""

    def track(self, measurement: LidarScan, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration from a predicted pose, or the reason why the scan gives none."""
        found = self._found(lambda tracker: Acquisition(tracker.track(measurement, T_sensor_target)))
        return found.registration


class NoisyScanSearch(_AtNoise[GlobalSearch]):
    """Finds the target in scans with the noise that they show: ports.ComparingAcquirer[LidarScan]."""

    def acquire(self, measurement: LidarScan) -> Acquisition:
        """Return the likeliest pose with its belief, and the other poses that explain the scan."""
        return self._found(lambda search: search.acquire(measurement))

    def near(self, measurement: LidarScan, T_sensor_target: RigidTransform) -> Acquisition:
        """Return the likeliest pose near a given one."""
        return self._found(lambda search: search.near(measurement, T_sensor_target))

    def log_likelihoods(self, measurement: LidarScan, found: Sequence[Registration]) -> FloatArray:
        """Return the log likelihoods of a scan near registered poses, (N,), with their largest noise."""
        stated_m = self._pattern.assumed_sigma_m
        noise_m = max([stated_m, *(each.belief.larger_noise_m for each in found)])
        return self._at(round(2.0 * log2(noise_m / stated_m))).log_likelihoods(measurement, found)


def _told(found: Acquisition, noise_m: float, stated_m: float) -> Acquisition:
    """Return a result whose evidence has the noise of a range that the scan shows, and the stated one, m."""
    belief = found.belief
    told = replace(belief, evidence={**belief.evidence, NOISE_M: noise_m, STATED_NOISE_M: stated_m})
    return replace(found, registration=replace(found.registration, belief=told))
