"""The sweep over tau, on comparisons made up for the purpose and on one of a scan."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_pose.lidar.paper_2015.tau_sweep import sweep_tau
from rpod_pose.lidar.paper_2015.template_matching import Comparison, OnlineTemplateMatching
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.lidar.methods import TemplateMatchingConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import LidarScan
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_target import load_target

TAUS = np.array([0.05, 0.1, 0.2, 0.5])


def compared(costs_m2, spread_differences):
    costs_m2 = np.array(costs_m2)
    return Comparison(costs_m2, np.zeros((len(costs_m2), 3)), np.array(spread_differences))


def test_success_and_templates_left_out_follow_from_the_best_kept_template():
    scans = [
        compared([1.0, 2.0, 3.0], [0.15, 0.08, 0.3]),
        compared([5.0, 4.0, np.inf], [0.01, 0.4, np.nan]),
    ]
    right = {(0, 0), (1, 1)}
    swept = sweep_tau(scans, lambda scan, template: (scan, template) in right, TAUS)
    assert swept.plain_success_share == 1.0
    assert swept.success_share == pytest.approx([0.0, 0.0, 0.5, 1.0])
    assert swept.excluded_share == pytest.approx([5 / 6, 4 / 6, 3 / 6, 1 / 6])


def test_the_smallest_tau_is_the_one_beyond_which_no_more_is_lost():
    scans = [compared([1.0, 2.0], [0.15, 0.01])]
    swept = sweep_tau(scans, lambda _, template: template == 0, TAUS)
    assert swept.smallest_tau(loss=0.0) == 0.2
    assert swept.smallest_tau(loss=1.0) == 0.05
    never = sweep_tau([compared([1.0, 2.0], [0.9, 0.01])], lambda _, template: template == 0, TAUS)
    assert never.smallest_tau(loss=0.5) == np.inf


def test_each_template_is_asked_for_once():
    asked = []

    def succeeds(scan, template):
        asked.append((scan, template))
        return True

    sweep_tau([compared([1.0, 2.0], [0.01, 0.02])], succeeds, TAUS)
    assert asked == [(0, 0)]


def test_the_sweep_keeps_what_the_fast_variant_keeps():
    lidar, target = LidarConfig(), load_target("envisat-bulky")
    pattern = ScanPattern.of(lidar.info())
    T = make_pose(rotation=Rotation.random(rng=np.random.default_rng(4)), translation_m=(0.0, 0.0, 20.0))
    points_m = LidarEmulator(lidar, target, seed=1).scan([T], frame=0).points_m.astype(np.float32)
    scan = LidarScan(stamp_ns=0, frame_id="", points_m=points_m)
    plain, fast = (
        OnlineTemplateMatching(TemplateMatchingConfig(step_deg=60, variant=variant, tau=0.2), target, pattern)
        for variant in ("plain", "fast")
    )
    comparison = plain.compare(scan.returns_m.astype(np.float64))
    chosen = fast.search(scan)
    swept = sweep_tau(
        [comparison],
        lambda _, template: comparison.costs_m2[template] == chosen.poses[0].cost_m2,
        np.array([0.2]),
    )
    assert swept.success_share == [1.0]
    assert swept.excluded_share == pytest.approx(chosen.excluded_share)
