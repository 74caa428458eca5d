"""Ranges that are too noisy to measure a pose, and what they tell together."""

import numpy as np
import pytest

from rpod_pose.pmd.joint.check.noisy_ranges import MedianError
from rpod_schemas.config.pmd.joint import JointAcceptanceConfig

LIMITS = JointAcceptanceConfig(bias_sigmas=2.0, scale_share=0.004)
T = np.array((0.0, 0.0, 10.0))


def reason(off_m: float, *, count: int = 100, sigma_m: float = 0.0, noise_m: float = 0.4) -> str:
    """Return the reason of ranges that are too long, beside pixels without the target or without a range."""
    noisy = 10.0 + off_m + noise_m * np.random.default_rng(5).standard_normal(count)
    range_m = np.append(noisy, (np.nan, 3.0))[None, :]
    shown = (
        np.full(range_m.shape, 10.0, np.float32),
        np.append(np.zeros(count + 1), -1).astype(np.int32)[None, :],
    )
    error = MedianError.of(range_m, shown, LIMITS.bias_sigmas)
    assert error.number == count
    return error.reason(LIMITS, 0.04, T, np.diag([0.0, 0.0, sigma_m**2, 0.0, 0.0, 0.0]))


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_many_noisy_ranges_contradict_a_distance_that_each_of_them_allows(sign):
    assert "the median of 100 ranges, noisy ones too, is at least" in reason(sign * 0.4)
    assert "limit 0.12 m" in reason(sign * 0.4)
    assert reason(sign * 0.1) == ""


def test_few_ranges_an_uncertain_pose_and_outliers_contradict_nothing():
    assert reason(0.4, count=4) == ""
    assert reason(0.4, sigma_m=0.3) == ""
    assert reason(0.0, noise_m=3.0) == ""
