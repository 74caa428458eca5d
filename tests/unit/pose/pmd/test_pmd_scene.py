"""What a frame shows of the target, and how badly poses explain it."""

from functools import cache

import cv2
import numpy as np
import pytest
from pmd_frames import CAMERA, depth_frame, frame_of
from scipy.spatial.transform import Rotation

from rpod_pose.pmd.depth_view import stray_light
from rpod_pose.pmd.fit import PmdFitter
from rpod_pose.pmd.scene import PmdScene, scene_of
from rpod_pose.pmd.simpler_surface import Surface
from rpod_schemas.config.motion import FACING
from rpod_schemas.config.pmd.search import PmdModelConfig, PmdSceneConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera
from rpod_target import load_target

POSE = make_pose(
    rotation=Rotation.from_euler("y", 30.0, degrees=True) * FACING, translation_m=(0.0, 0.0, 4.0)
)
mockup = cache(lambda: load_target("mockup"))
ideal = cache(lambda: depth_frame(mockup(), POSE, noise_m=0.005))
SKY = np.random.default_rng(3).integers(0, 4, (CAMERA.height, CAMERA.width)).astype(np.uint16)


def scene(depth_m, amplitude=None) -> PmdScene:
    result = scene_of(frame_of(depth_m, amplitude=amplitude), PmdSceneConfig(), radius_m=mockup().radius_m)
    assert isinstance(result, PmdScene)
    return result


def shade(value: int, sky=SKY):
    """Return an amplitude image with this value on the target."""
    return np.where(np.isfinite(ideal().depth_m), value, sky).astype(np.uint16)


def without_middle():
    """Return the depth, and which of its pixels lost it."""
    lost = np.zeros(ideal().depth_m.shape, bool)
    lost[130:160, 160:190] = True
    return np.where(lost, np.nan, ideal().depth_m), lost


def coarsely(result: PmdScene, pixels):
    view = result.view
    return pixels[view.offset :: view.stride, view.offset :: view.stride]


def lit_where(result: PmdScene, pixels):
    return result.lit[coarsely(result, pixels)]


def test_a_dark_part_without_depth_is_told_from_the_sky():
    depth_m, lost = without_middle()
    assert lit_where(scene(depth_m, np.where(lost, 12, shade(200)).astype(np.uint16)), lost).mean() > 0.99
    assert lit_where(scene(depth_m, np.where(lost, SKY, shade(200)).astype(np.uint16)), lost).mean() < 0.01


def glinting():
    """Return a frame with a glint on the target's edge, and where it is."""
    glint = np.zeros(ideal().depth_m.shape, bool)
    glint[60:140, 120:200] = True
    depth_m = np.where(glint, np.nan, ideal().depth_m)
    return scene(depth_m, np.where(glint, 0, shade(200)).astype(np.uint16)), glint


def test_what_a_glint_wiped_out_is_neither_lit_nor_dark():
    result, glint = glinting()
    assert coarsely(result, glint)[result.blind].mean() > 0.8
    assert result.blind[coarsely(result, glint)].mean() > 0.95
    assert lit_where(result, glint).mean() < 0.05


def test_a_glint_speaks_for_no_pose_and_against_none():
    whole = scene(ideal().depth_m, shade(200))
    R, t = POSE.rotation.as_matrix(), POSE.translation
    fits = [
        PmdFitter(PmdModelConfig(), Surface.of(mockup()), one, known_materials=False).fit(R, t)
        for one in (glinting()[0], whole)
    ]
    assert fits[0].mean_loss == pytest.approx(fits[1].mean_loss, abs=0.05)


def test_lost_depth_hardly_moves_the_middle_of_what_is_seen():
    middle_m = scene(ideal().depth_m, shade(200)).surface.points_m.mean(axis=0)
    lost = ideal().depth_m.copy()
    lost[:, :175] = np.nan
    result = scene(lost, shade(200))
    assert np.linalg.norm(result.points_m.mean(axis=0) - middle_m) > 0.15
    assert np.linalg.norm(result.surface.points_m.mean(axis=0) - middle_m) < 0.1


def test_what_hides_the_target_does_not_move_the_middle_of_what_is_seen():
    """An arm may reach far beyond the target; a part that a glint wiped out is the target's."""
    arm = np.zeros(ideal().depth_m.shape, bool)
    arm[:100, 40:60] = True
    seen = frame_of(ideal().depth_m, amplitude=np.where(arm, 0, shade(200)).astype(np.uint16))
    middles_m = []
    for hidden in (None, arm):
        result = scene_of(
            seen.model_copy(update={"hidden": hidden}), PmdSceneConfig(), radius_m=mockup().radius_m
        )
        assert isinstance(result, PmdScene)
        middles_m.append(result.surface.points_m.mean(axis=0))
    right_m = scene(ideal().depth_m, shade(200)).surface.points_m.mean(axis=0)
    assert np.linalg.norm(middles_m[0] - right_m) > 0.05
    assert np.linalg.norm(middles_m[1] - right_m) < 0.01


def test_other_materials_change_the_loss_of_the_amplitude_alone():
    R, t = POSE.rotation.as_matrix(), POSE.translation
    even = scene(ideal().depth_m, shade(200))
    fits = [
        PmdFitter(PmdModelConfig(), Surface.of(mockup()), even, known_materials=known).fit(R, t)
        for known in (True, False)
    ]
    assert fits[0].loss > 2.0 * fits[1].loss
    assert fits[1].mean_loss < 0.2


def test_the_noise_of_the_sky_is_not_lit_beside_a_faint_target():
    sky = np.random.default_rng(3).rayleigh(4.0, ideal().depth_m.shape)
    result = scene(ideal().depth_m, shade(20, sky=sky))
    assert not lit_where(result, cv2.dilate(np.isfinite(ideal().depth_m) * 1.0, np.ones((5, 5))) == 0.0).any()


def test_the_zeros_of_a_sky_without_noise_are_no_glint():
    result = scene(ideal().depth_m, shade(200, sky=0))
    assert result.lit.mean() == pytest.approx((result.range_m > 0.0).mean(), abs=0.02)


@pytest.mark.parametrize("noise", [0, 1])
def test_a_sky_that_is_as_bright_as_dark_parts_is_not_lit(noise):
    """Eight bits with a pedestal: the darkest part has 60 counts, the sky 20."""
    depth_m, lost = without_middle()
    amplitude = shade(60, sky=20 + SKY % (noise + 1))
    result = scene(depth_m, np.where(lost, 40, amplitude).astype(np.uint8))
    assert lit_where(result, lost).mean() > 0.95
    assert lit_where(result, ~np.isfinite(ideal().depth_m)).mean() < 0.01


def test_about_as_many_pixels_are_looked_at_at_any_range():
    for range_m in (2.5, 4.0, 6.0):
        T = make_pose(rotation=FACING, translation_m=(0.0, 0.0, range_m))
        points = len(scene(depth_frame(mockup(), T).depth_m).points_m)
        assert 800 < points < 4000


def test_what_lies_far_behind_is_not_of_the_target():
    depth_m = np.where(np.isfinite(ideal().depth_m), ideal().depth_m, 7.4)
    depth_m[:, :80] = np.nan
    depth_m[:, 270:] = np.nan
    depth_m[:60] = np.nan
    depth_m[220:] = np.nan
    assert scene(depth_m).points_m[:, 2].max() < 6.0


def test_the_right_pose_explains_a_frame_best():
    result = scene(ideal().depth_m)
    fitter = PmdFitter(PmdModelConfig(), Surface.of(mockup()), result)
    right = fitter.fit(POSE.rotation.as_matrix(), POSE.translation)
    assert right.mean_loss < 0.2
    for axis in np.eye(3):
        moved = fitter.fit(POSE.rotation.as_matrix(), POSE.translation + 0.1 * axis)
        turned = POSE.rotation * Rotation.from_rotvec(0.2 * axis)
        assert moved.loss > 2.0 * right.loss
        assert fitter.fit(turned.as_matrix(), POSE.translation).loss > 1.2 * right.loss


def test_the_refinement_never_makes_a_pose_worse():
    fitter = PmdFitter(PmdModelConfig(), Surface.of(mockup()), scene(ideal().depth_m))
    draws = np.random.default_rng(1).standard_normal((3, 16, 6))
    off = make_pose(
        rotation=POSE.rotation * Rotation.from_rotvec([0.03, 0.0, 0.02]), translation_m=(0.02, 0.0, 4.01)
    )
    R, t = off.rotation.as_matrix(), off.translation
    *refined, deviations = fitter.outline_refined(R, t, np.full(6, 0.02), draws)
    assert fitter.fit(*refined).loss < fitter.fit(R, t).loss
    assert (deviations < 0.02).all()


def veiled(*, fills: int):
    """Return depth and amplitude of a plate beside which a lens scatters 6 % of its light, and the plate."""
    plate = np.zeros((172, 224), bool)
    plate[80 : 80 + fills, 90 : 90 + fills] = True
    shade = np.where(plate, np.float32(150.0), np.float32(0.0))
    amplitude = 0.94 * shade + 0.06 * cv2.GaussianBlur(shade, (0, 0), 18.0)
    return np.where(amplitude > 0.5, np.float32(4.0), np.float32(np.nan)), amplitude, plate


@pytest.mark.parametrize("fills", [20, 40, 80])
def test_light_that_the_lens_scatters_beside_a_target_is_no_surface_however_little_it_fills(fills):
    depth_m, amplitude, plate = veiled(fills=fills)
    camera = Camera(width=224, height=172, fx=200.0, fy=200.0, cx=111.5, cy=85.5)
    image = amplitude.astype(np.uint16)
    frame = frame_of(depth_m, amplitude=image, camera=camera)
    beside = ~cv2.dilate(plate.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    assert np.isfinite(depth_m[beside]).sum() > 100
    least = stray_light(frame, PmdSceneConfig().ghost_share)
    assert not (image >= least)[np.isfinite(depth_m) & beside].any()
    assert (image >= least)[plate].all()
    result = scene_of(frame, PmdSceneConfig(), radius_m=5.0)
    assert isinstance(result, PmdScene)
    assert not (result.range_m > 0.0)[coarsely(result, beside)].any()
    assert (result.range_m > 0.0)[coarsely(result, plate)].mean() > 0.9


def test_a_dark_part_is_not_taken_for_stray_light_of_a_lens():
    amplitude = np.where(without_middle()[1], 30, shade(200)).astype(np.uint16)
    frame = frame_of(ideal().depth_m, amplitude=amplitude)
    least = stray_light(frame, PmdSceneConfig().ghost_share)
    assert (amplitude >= least)[np.isfinite(ideal().depth_m)].all()
