from functools import cache

import numpy as np
import pytest
from pmd_frames import strange_frames
from pmd_views import mockup, pmd_view
from scipy.spatial.transform import Rotation

from rpod_pose.methods import methods_of
from rpod_pose.pmd.paper_2018.hybrid import HybridTracker, fused, squared_difference
from rpod_pose.ports import Registration
from rpod_schemas.config.estimator import PmdInput
from rpod_schemas.config.motion import FACING
from rpod_schemas.config.pmd.amplitude import HybridConfig
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.types import Source

POSE = make_pose(rotation=FACING, translation_m=(0.05, -0.03, 5.0))
GUESS = make_pose(
    rotation=Rotation.from_rotvec((0.02, -0.01, 0.03)) * FACING, translation_m=(0.07, -0.02, 5.05)
)
hybrid = cache(lambda: HybridTracker(HybridConfig(), mockup()))
view = cache(lambda: pmd_view(POSE))


def tracked(**changes):
    return hybrid().track(view().model_copy(update=changes), GUESS)


def error_deg(registration):
    return np.rad2deg(np.linalg.norm(pose_error(POSE, registration.T_sensor_target)[0]))


def test_two_techniques_that_agree_are_fused():
    registration = tracked()
    assert registration.source == Source.PMD_JOINT
    assert error_deg(registration) < 0.5


def test_without_depth_the_amplitude_is_taken():
    registration = tracked(depth_m=np.full_like(view().depth_m, np.nan))
    assert registration.source == Source.PMD_AMPLITUDE
    assert error_deg(registration) < 0.7


@pytest.mark.parametrize("amplitude", [None, np.full((287, 352), 700, np.uint16)], ids=["none", "constant"])
def test_without_edges_the_depth_is_taken(amplitude):
    registration = tracked(amplitude=amplitude)
    assert registration.source == Source.PMD_DEPTH
    assert error_deg(registration) < 1.5


def test_without_both_there_are_both_reasons():
    reason = tracked(amplitude=None, depth_m=np.full_like(view().depth_m, np.nan)).belief.reason
    assert "depth: 0 pixels" in reason
    assert "amplitude: no amplitude" in reason


@pytest.mark.parametrize("frame", strange_frames().values(), ids=strange_frames().keys())
def test_no_frame_raises_and_without_a_pose_there_is_a_reason(frame):
    registration = hybrid().track(frame, GUESS)
    assert bool(registration.belief.reason) != registration.continues_track


def registration_at(translation_m, rotvec, sigmas):
    pose = make_pose(rotation=Rotation.from_rotvec(rotvec), translation_m=translation_m)
    return Registration(Source.PMD_DEPTH, pose, covariance=np.diag(np.square(sigmas)), inliers=3)


def test_the_surer_pose_draws_the_fused_one_to_itself():
    sure = registration_at((0.0, 0.0, 4.0), (0.0, 0.0, 0.0), [0.01] * 6)
    vague = registration_at((0.0, 0.0, 4.1), (0.0, 0.0, 0.05), [0.03] * 6)
    for first, second in ((sure, vague), (vague, sure)):
        mean = fused(first, second)
        assert np.allclose(mean.T_sensor_target.translation, (0.0, 0.0, 4.01))
        assert np.allclose(mean.T_sensor_target.rotation.as_rotvec(), (0.0, 0.0, 0.005))
        assert np.allclose(mean.covariance, 0.9e-4 * np.eye(6))


def test_the_squared_difference_counts_in_sigmas():
    first = registration_at((0.0, 0.0, 4.0), (0.0, 0.0, 0.0), [0.03] * 6)
    second = registration_at((0.1, 0.0, 4.0), (0.0, 0.1, 0.0), [0.04] * 6)
    assert squared_difference(first, second) == pytest.approx(2 * (0.1 / 0.05) ** 2)


@pytest.mark.parametrize("kind", ["epnp", "hybrid"])
def test_the_configuration_selects_the_method(kind):
    methods = methods_of(PmdInput.model_validate({"tracking": {"kind": kind}}), mockup())
    registration = methods.tracker.track(view(), GUESS)
    assert registration.source == (Source.PMD_AMPLITUDE if kind == "epnp" else Source.PMD_JOINT)
