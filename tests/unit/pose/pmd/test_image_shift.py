"""A prediction beyond the reach of the search for edges is moved to where its image is found."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from tests.unit.pose.pmd.test_joint import CAMERA, MOCKUP, TRACKER, assert_within, error, frame

from rpod_pose.pmd.joint.brightness.patch_renderer import PatchRenderer
from rpod_pose.pmd.joint.frame import JointFrame
from rpod_pose.pmd.joint.image_shift import found_in_image
from rpod_pose.registration.lie_group import PoseArrays
from rpod_schemas.config.motion import FACING
from rpod_schemas.config.pmd.joint import JointConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import PmdFrame

AWAY_M = 6.5
TURN = FACING * Rotation.from_euler("ZYX", (8.0, -12.0, 25.0), degrees=True)
TRUTH = make_pose(rotation=TURN, translation_m=(0.2, -0.1, AWAY_M))
TUNING = JointConfig().tuning
RENDERER = PatchRenderer(MOCKUP, TUNING.edges)


def shifted(column_px: float, row_px: float) -> RigidTransform:
    """Return the true pose, turned by 2 deg and moved in the image."""
    moved_m = AWAY_M / CAMERA.camera.fx * np.array((column_px, row_px, 0.0))
    turned = Rotation.from_euler("Y", 2.0, degrees=True) * TURN
    return make_pose(rotation=turned, translation_m=TRUTH.translation + moved_m)


def found(shown: PmdFrame, T: RigidTransform) -> tuple[PoseArrays, PoseArrays]:
    """Return a prediction, and where its image is found."""
    pose = PoseArrays.of(T)
    seen = JointFrame.of(shown, pose.t, radius_m=MOCKUP.radius_m, tuning=TUNING)
    assert isinstance(seen, JointFrame)
    return pose, found_in_image(seen, RENDERER.render(seen.rays, seen.per_px, pose, seen.patch).shown)


@pytest.mark.parametrize("off_px", [(13.0, -6.0), (-9.0, 12.0)])
def test_the_image_of_a_prediction_is_found_to_a_pixel(off_px: tuple[float, float]) -> None:
    _, pose = found(frame(TRUTH), shifted(*off_px))
    left_px = CAMERA.camera.fx / AWAY_M * (pose.t - TRUTH.translation)
    assert np.abs(left_px).max() < 1.5


def test_a_prediction_in_its_place_or_without_an_amplitude_stays_as_it_is() -> None:
    shown = frame(TRUTH)
    pose, same = found(shown, TRUTH)
    assert same is pose
    pose, same = found(shown.model_copy(update={"amplitude": None}), shifted(13.0, 0.0))
    assert same is pose


def test_a_distant_target_with_little_depth_is_found_beyond_the_reach_of_its_edges() -> None:
    shown = frame(TRUTH)
    depth_m = np.where(np.random.default_rng(1).random(shown.depth_m.shape) < 0.05, shown.depth_m, np.nan)
    little = shown.model_copy(update={"depth_m": depth_m.astype(shown.depth_m.dtype)})
    tracked = TRACKER.track(little, shifted(13.0, -6.0))
    assert tracked.continues_track
    assert_within(error(tracked, TRUTH), 0.2, 0.01)
