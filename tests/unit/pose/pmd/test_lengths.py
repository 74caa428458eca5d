"""Lengths of the methods by depth and by corners follow from the size of what is seen."""

from functools import cache
from math import inf
from pathlib import Path

import numpy as np
import pytest
import yaml
from pmd_frames import depth_frame
from scipy.spatial.transform import Rotation

from rpod_pose.pmd.depth_result import ResultLengths, size_of
from rpod_pose.pmd.depth_view import usable_image
from rpod_pose.pmd.paper_2018.icp_reverse_calibration import ReverseCalibrationIcp
from rpod_pose.pmd.signed_distance import SignedDistanceTracker
from rpod_schemas.config.motion import FACING
from rpod_schemas.config.pmd.amplitude import EpnpConfig
from rpod_schemas.config.pmd.lengths import relative_size
from rpod_schemas.config.pmd.methods import (
    DepthImageConfig,
    IcpReverseCalibrationConfig,
    SignedDistanceConfig,
    SignedDistanceTuning,
)
from rpod_schemas.poses import make_pose, pose_error
from rpod_target import load_target

mockup = cache(lambda: load_target("mockup"))
METHODS = {
    "signed distance": lambda target: SignedDistanceTracker(SignedDistanceConfig(), target),
    "ICP": lambda target: ReverseCalibrationIcp(IcpReverseCalibrationConfig(), target),
}


def scaled(value, factor, key=""):
    if isinstance(value, dict):
        return {name: scaled(inner, factor, name) for name, inner in value.items()}
    if isinstance(value, list):
        return [scaled(inner, factor, key) for inner in value]
    return value * factor if key.endswith("_m") and isinstance(value, float) else value


@pytest.fixture(scope="module")
def sixty_metres(tmp_path_factory):
    """The mock-up, fifty times as large."""
    file = Path(mockup().source)
    whole = scaled(yaml.safe_load(file.read_text("utf-8")), 50.0) | {"name": "large"}
    path = tmp_path_factory.mktemp("large") / "large.yaml"
    path.write_text(yaml.safe_dump(whole), "utf-8")
    return load_target(str(path))


@pytest.mark.parametrize("method", METHODS)
def test_a_body_of_sixty_metres_is_tracked_like_the_mockup(method, sixty_metres):
    """Scales of 0.1 m gave no pose of it from a prediction 4 m off."""
    turn = Rotation.from_euler("xyz", [20, 30, -10], degrees=True)
    T = make_pose(rotation=turn * FACING, translation_m=(2.0, -1.0, 200.0))
    off = make_pose(rotation=Rotation.from_rotvec([0.05, -0.06, 0.03]), translation_m=(2.0, -3.0, 2.0))
    found = METHODS[method](sixty_metres).track(depth_frame(sixty_metres, T, noise_m=0.02), T * off)
    assert found.begins_track, found.belief.refusal
    attitude_rad, position_m = pose_error(T, found.T_sensor_target)
    assert np.degrees(np.linalg.norm(attitude_rad)) < 0.2
    assert np.linalg.norm(position_m) < 0.3


def test_the_lengths_of_the_mockup_are_those_of_its_campaigns():
    size = relative_size(mockup().radius_m, inf)
    assert size == 1.0
    assert IcpReverseCalibrationConfig().match_lengths(size) == (0.24, 0.15, 0.3, 0.002)
    assert ResultLengths.of(IcpReverseCalibrationConfig(), size) == (0.02, 0.12, 0.003)
    assert SignedDistanceTuning().scales_m(size) == (0.10, 0.03)
    assert ResultLengths.of(SignedDistanceTuning(), size) == (0.02, 0.12, 0.003)
    assert EpnpConfig().reaches_m(size) == (0.12, 0.12)


def test_lengths_grow_with_the_body_and_never_fall_below_the_noise_of_the_depth():
    icp, signed = IcpReverseCalibrationConfig(), SignedDistanceTuning()
    assert icp.match_lengths(10.0) == pytest.approx((2.4, 1.5, 3.0, 0.02))
    assert ResultLengths.of(icp, 10.0) == pytest.approx((0.2, 0.12, 0.3))  # the camera's errors do not grow
    assert icp.match_lengths(0.1).scale_m * icp.final_share == pytest.approx(icp.errors.noise_m)
    assert ResultLengths.of(icp, 0.1) == pytest.approx((0.002, 0.06, 0.0004))
    assert signed.scales_m(0.1) == (0.02, 0.02)


def test_given_lengths_are_kept():
    icp = IcpReverseCalibrationConfig(
        direct_m=0.1, scale_m=0.2, gate_m=0.4, step_m=0.01, unsettled_m=0.05, comparison={"tolerance_m": 0.3},
        acceptance={"max_cost_m2": 0.7, "min_explained_share": 0.5},
    )  # fmt: skip
    assert icp.match_lengths(7.0) == (0.1, 0.2, 0.4, 0.01)
    assert ResultLengths.of(icp, 7.0) == (0.05, 0.3, 0.7)
    assert SignedDistanceTuning(scale_m=0.2, final_scale_m=0.1).scales_m(7.0) == (0.2, 0.1)


def test_what_counts_of_a_body_that_is_larger_than_its_range_is_what_is_seen():
    image = usable_image(depth_frame(mockup(), make_pose(translation_m=(0, 0, 4))), DepthImageConfig())
    assert size_of(mockup(), image) == 1.0
    assert relative_size(47.0, 8.0) == relative_size(8.0, 100.0)
