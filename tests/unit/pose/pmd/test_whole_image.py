"""A coarse first pose is moved to the likeliest one nearby, by the whole image."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from pmd_frames import frame_of
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.belief import Belief
from rpod_pose.pmd.joint.tracker import JointTracker
from rpod_pose.pmd.joint.whole_image.first_pose import COARSE, is_coarse
from rpod_pose.pmd.view_search import _Aligned
from rpod_pose.ports import Registration
from rpod_pose.registration.lie_group import PoseArrays, moved
from rpod_schemas.config.motion import FACING
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.config.pmd.joint import JointConfig
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.types import BeliefLevel, PmdFrame, Source
from rpod_sim_sensor.pmd import PmdEmulator
from rpod_target import load_target

TRUTH = make_pose(
    rotation=Rotation.from_euler("yx", (30.0, 20.0), degrees=True) * FACING, translation_m=(0.1, -0.1, 9.0)
)
STEP = np.array((0.02, -0.03, 0.05, 0.02, -0.01, 0.02))
target = cache(lambda: load_target("mockup"))
tracker = cache(lambda: JointTracker(JointConfig(), target()))


@cache
def seen() -> PmdFrame:
    config = PmdConfig().model_copy(update={"subsamples": 4})
    exposure = PmdEmulator(config, target(), seed=3).expose([TRUTH] * 4, sun_W_m2=np.zeros(3), frame=0)
    return frame_of(exposure.depth_m, amplitude=exposure.amplitude)


def registered(T: RigidTransform, sigma_m: float) -> Registration:
    nothing = Registration.none(Source.PMD_JOINT, "")
    belief = Belief(BeliefLevel.ACCEPTED)
    covariance = np.diag((*[sigma_m**2] * 3, *[1e-3] * 3))
    return replace(nothing, T_sensor_target=T, belief=belief, covariance=covariance, range_bias_m=0.0)


def test_a_coarse_pose_is_moved_to_the_likeliest_one_nearby():
    start = registered(moved(TRUTH, STEP), sigma_m=0.05)
    found = tracker().climbed(seen(), start)
    before, after = (pose_error(TRUTH, each.T_sensor_target) for each in (start, found))
    for now, then in zip(after, before, strict=True):  # of attitude and position
        assert np.linalg.norm(now) < 0.3 * np.linalg.norm(then)
    assert found.covariance is start.covariance


@pytest.mark.parametrize(
    ("step", "sigma_m"), [(0.0 * STEP, 0.05), (STEP, 1e-3)], ids=["the likeliest pose", "a fine pose"]
)
def test_other_poses_remain(step: np.ndarray, sigma_m: float):
    start = registered(moved(TRUTH, step), sigma_m)
    assert tracker().climbed(seen(), start) is start


def test_a_frame_without_amplitude_moves_no_pose():
    start = registered(moved(TRUTH, STEP), sigma_m=0.05)
    assert tracker().climbed(seen().model_copy(update={"amplitude": None}), start) is start


def test_a_pose_is_coarse_by_its_worst_direction():
    radius_m = target().radius_m
    assert is_coarse(registered(TRUTH, 1.01 * COARSE * radius_m), radius_m)
    assert not is_coarse(registered(TRUTH, 0.99 * COARSE * radius_m), radius_m)


def test_a_search_reports_the_moved_pose():
    class Moving:
        def climbed(self, _: object, found: Registration) -> Registration:
            return replace(found, T_sensor_target=moved(TRUTH, STEP))

    at_truth = PoseArrays.of(TRUTH)
    pose = _Aligned(*at_truth, registered(TRUTH, 0.05), np.zeros(2), at_truth)
    end = pose.climbed(Moving(), seen())
    assert np.allclose(end.R, moved(TRUTH, STEP).rotation.as_matrix())
    assert np.allclose(end.t, end.registration.T_sensor_target.translation)
    assert pose.climbed(object(), seen()) is pose
