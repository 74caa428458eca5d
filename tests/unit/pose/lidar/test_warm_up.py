"""Warm-up of the LIDAR's methods: what a first scan needs is compiled before it arrives."""

import numpy as np
import pytest
from lidar_scans import BULKY, LIDAR, load

from rpod_pose.lidar import scan_fit
from rpod_pose.lidar.methods import ideal_scan
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.methods import ready_methods
from rpod_schemas.config.estimator import LidarInput
from rpod_schemas.poses import make_pose

PATTERN = ScanPattern.of(LIDAR.info())


@pytest.mark.parametrize("range_m", [8.0, 30.0, 150.0])
def test_the_second_ideal_scan_has_few_returns(range_m):
    whole, few = ideal_scan(load(BULKY), make_pose(translation_m=[0.0, 0.0, range_m]), PATTERN)
    count = np.isfinite(few.points_m[..., 0]).sum()
    assert 0 < count <= 24
    assert np.isfinite(whole.points_m[..., 0]).sum() >= count


def test_the_posterior_is_sampled_in_the_warm_up(monkeypatch):
    calls = []
    sampled = scan_fit.sampled_posterior
    monkeypatch.setattr(scan_fit, "sampled_posterior", lambda *args: calls.append(args) or sampled(*args))
    ready_methods(LidarInput(), load(BULKY), PATTERN)
    assert calls
