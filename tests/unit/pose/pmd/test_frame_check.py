from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.rays import RayGrid, cast
from rpod_pose.belief import PixelMarks
from rpod_pose.pmd.joint.brightness.amplitude_noise import (
    noise_of,
    noise_of_change,
    noise_of_place,
    typical_of,
)
from rpod_pose.pmd.joint.check.frame_check import Contradictions, SeenPixels, contradictions
from rpod_pose.pmd.rendering import FineRanges, Rendering
from rpod_schemas.config.motion import FACING
from rpod_schemas.config.pmd.check import PmdCheckConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera
from rpod_target import Target, load_target

TARGET = load_target("mockup")
LIMITS = PmdCheckConfig()
CAMERA = Camera(width=88, height=72, fx=170.0, fy=172.0, cx=43.5, cy=35.5)
RAYS = RayGrid.pinhole(CAMERA)
STRIDE = 4
POSE = make_pose(
    rotation=Rotation.from_euler("y", 15.0, degrees=True) * FACING, translation_m=(0.0, 0.0, 4.0)
)
SKY, LIT = 2.0, 100.0
SEEN = {"radius_m": TARGET.radius_m, "typical": LIT}


def rendered(T: RigidTransform = POSE, target: Target = TARGET) -> Rendering:
    """Return what the camera, every ``STRIDE``-th pixel of a finer one, would see."""
    hits, matrix = cast(RAYS, target.triangles_m, T, cull_back_faces=True), T.as_matrix()
    R, t = matrix[:3, :3].copy(), matrix[:3, 3].copy()
    return Rendering(hits.range_m, hits.triangle, RAYS, STRIDE, STRIDE * CAMERA.fx, target.triangles_m, R, t)


def seen(*, noise_m: float = 0.0, T: RigidTransform = POSE, target: Target = TARGET):
    """Return ranges, their noise, and amplitudes."""
    there = rendered(T, target)
    rng = np.random.default_rng(1)
    shape, on = there.range_m.shape, there.triangle >= 0
    measured_m = np.where(on, there.range_m, np.nan) + noise_m * rng.standard_normal(shape)
    shade = np.where(on, LIT, SKY + 0.3 * rng.standard_normal(shape))
    return measured_m, np.full(shape, noise_m), shade


def compared(images, **kwargs) -> Contradictions:
    return contradictions(SeenPixels(*images), rendered(), LIMITS, **SEEN, **kwargs)


def test_the_noise_of_the_sky_contradicts_no_pose_of_a_faint_target():
    range_m, sigma_m, shade = seen()
    sky = np.random.default_rng(2).normal(5.0, 1.0, shade.shape)
    images = SeenPixels(range_m, sigma_m, np.where(shade == LIT, 25.0, sky))
    faint = contradictions(images, rendered(), LIMITS, radius_m=TARGET.radius_m, typical=25.0)
    assert (sky[shade != LIT] > 8.0).sum() > 3  # three sigma, and more than a quarter of what is typical
    assert faint.inconsistent == 0


def without(part: str) -> Target:
    """Return the mock-up without one of its parts."""
    kept = TARGET.triangle_part != TARGET.parts.index(part)
    return replace(TARGET, triangles_m=TARGET.triangles_m[kept])


@pytest.mark.parametrize("noise_m", [0.0, 0.03, 0.1])
def test_at_the_right_pose_noise_contradicts_nowhere(noise_m):
    found = compared(seen(noise_m=noise_m))
    assert found.reason(LIMITS) == ""
    assert found.explained_share > 0.99
    assert found.pixels == np.count_nonzero(rendered().triangle >= 0)


def test_what_all_ranges_are_too_long_by_is_no_contradiction():
    range_m, sigma_m, shade = seen()
    long = range_m + 0.2, sigma_m, shade
    assert compared(long).reason(LIMITS)
    assert not compared(long, bias_m=0.2).reason(LIMITS)


def test_a_detail_out_of_place_contradicts():
    turned = POSE * make_pose(rotation=Rotation.from_euler("x", 60.0, degrees=True))
    assert "are inconsistent with the pose" in compared(seen(T=turned)).reason(LIMITS)


def test_a_dark_place_where_surface_should_be_contradicts_and_a_wiped_one_does_not():
    range_m, sigma_m, shade = seen()
    hole = (slice(30, 40), slice(38, 48))
    range_m[hole] = np.nan
    for level, contradicts in ((SKY, True), (0.0, False), (np.nan, False), (LIT, False)):
        shade[hole] = level
        assert bool(compared((range_m, sigma_m, shade)).reason(LIMITS)) is contradicts


def test_a_bright_place_where_no_surface_should_be_contradicts():
    images = seen()
    images[2][2:8, 2:8] = LIT
    found = compared(images)
    assert "a detail is inconsistent" in found.reason(LIMITS)
    assert np.argwhere(found.marked).tolist() == [[i, j] for i in range(2, 8) for j in range(2, 8)]
    assert PixelMarks(found.marked, STRIDE).centre_px == (20, 20)


def test_a_few_dark_pixels_say_that_a_surface_is_missing_where_as_many_wrong_ranges_may_be_noise():
    few = (np.array((30, 30, 31, 31, 32)), np.array((34, 35, 34, 35, 34)))
    assert (rendered().triangle[few] >= 0).all()
    range_m, sigma_m, shade = seen()
    range_m[few] += 0.5
    assert compared((range_m, sigma_m, shade)).reason(LIMITS) == ""
    range_m[few], shade[few] = np.nan, SKY
    assert compared((range_m, sigma_m, shade)).reason(LIMITS) == (
        "a detail is missing: 5 of 25 pixels of a patch are dark, limit 3"
    )


@pytest.mark.parametrize(("angle_deg", "contradicts"), [(75.0, True), (83.0, False)])
def test_foil_that_is_seen_obliquely_may_be_as_dark_as_the_sky(angle_deg, contradicts):
    oblique = Rotation.from_euler("y", angle_deg, degrees=True) * FACING
    pose = make_pose(rotation=oblique, translation_m=(0.0, 0.0, 2.5))
    there = rendered(pose)
    front = (there.triangle >= 0) & (TARGET.normals[there.triangle, 0] > 0.99)
    front &= TARGET.triangle_part[there.triangle] == TARGET.parts.index("body")
    range_m, sigma_m, shade = seen(T=pose)
    range_m[front], shade[front] = np.nan, SKY
    found = contradictions(SeenPixels(range_m, sigma_m, shade), there, LIMITS, **SEEN)
    assert bool(found.reason(LIMITS)) is contradicts


@pytest.mark.parametrize("part", ["nose", "box", "bracket"])
def test_a_part_that_is_not_there_contradicts(part):
    assert "is inconsistent with the pose" in compared(seen(target=without(part))).reason(LIMITS)


@pytest.mark.parametrize(("off_px", "contradicts"), [(0.4, False), (1.5, True)])
def test_an_outline_may_be_off_by_some_pixels_of_the_image_and_not_by_a_coarse_one(off_px, contradicts):
    aside_m = off_px * POSE.translation[2] / CAMERA.fx
    moved = make_pose(rotation=POSE.rotation, translation_m=POSE.translation + aside_m * np.eye(3)[0])
    assert bool(compared(seen(T=moved)).reason(LIMITS)) is contradicts


@pytest.mark.parametrize(("inconsistent", "refused"), [(3, False), (4, True)])
def test_of_few_pixels_some_may_contradict(inconsistent, refused):
    assert (
        bool(
            Contradictions(pixels=21, inconsistent=inconsistent, most_in_patch=1, most_missing=0).reason(
                LIMITS
            )
        )
        is refused
    )


def test_where_nothing_is_seen_nothing_is_explained():
    nothing = np.full(RAYS.shape, np.nan)
    assert compared((nothing, nothing, nothing)) == Contradictions(0, 0, 0, 0)
    assert Contradictions(0, 0, 0, 0).explained_share == 0.0


def test_the_noise_of_an_image_is_told_in_spite_of_slopes_and_edges():
    rng = np.random.default_rng(2)
    row, column = np.mgrid[:200, :200]
    image = (50.0 + 0.5 * row + column + 200.0 * (column % 80 > 40)).astype(np.float32)
    noisy = (image + 4.0 * rng.standard_normal(image.shape)).astype(np.float32)
    assert noise_of(noisy, 0.0) == pytest.approx(4.0, rel=0.1)
    assert noise_of(noisy, 1e4) == 0.0


@pytest.mark.parametrize("blur_px", [0.8, 1.5])
def test_a_blur_leaves_of_noise_what_is_expected(blur_px):
    noise = np.random.default_rng(3).standard_normal((500, 500)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), blur_px)
    change = smooth[:, 2:] - smooth[:, :-2]
    assert noise_of_change(blur_px) == pytest.approx(float(change.std()), rel=0.05)


def test_the_noise_of_an_edge_s_place_follows_from_the_blur():
    """1200 rows of a step of 20 standard deviations: spread of the steepest place, by a parabola."""
    rng, blur_px, noise = np.random.default_rng(5), 0.8, 0.05
    step = np.concatenate((np.zeros(10), [0.5], np.ones(10)))
    image = step + noise * rng.normal(size=(12_000, 21))
    blurred = cv2.GaussianBlur(image, (0, 0), blur_px)[::10]
    change = blurred[:, 2:] - blurred[:, :-2]
    behind, most, ahead = change[:, 8], change[:, 9], change[:, 10]
    places = 0.5 * (behind - ahead) / (behind - 2.0 * most + ahead)
    expected_px = noise_of_place(blur_px) * noise / float(most.mean())
    assert float(places.std()) == pytest.approx(expected_px, rel=0.15)


@pytest.mark.parametrize("start", [120.0, 300.0, 700.0])
def test_what_is_typical_is_neither_the_sky_nor_a_glint_wherever_one_starts(start: float) -> None:
    generator = np.random.default_rng(5)
    image = generator.uniform(0.0, 20.0, (120, 160)).astype(np.float32)
    image[20:100, 20:140] = generator.uniform(200.0, 400.0, (80, 120))
    image[30:60, 30:70], image[70:90, 30:70] = 0.0, 60000.0
    depth_m = np.where(image > 100.0, np.float32(5.0), np.float32(np.nan))
    assert typical_of(image, start, depth_m) == pytest.approx(300.0, rel=0.05)
    assert typical_of(np.zeros_like(image), 0.0, np.full_like(image, np.nan)) == 0.0


def test_the_sky_is_not_what_is_typical_of_a_small_faint_target() -> None:
    generator = np.random.default_rng(6)
    image = np.hypot(*generator.normal(0.0, 50.0, (2, 120, 160))).astype(np.float32)
    depth_m = np.full(image.shape, np.nan, np.float32)
    image[50:60, 70:90], depth_m[50:60, 70:90] = generator.uniform(180.0, 260.0, (10, 20)), 5.0
    assert np.median(image) > 0.25 * 220.0  # by a quarter of what is typical, the sky is not darker
    assert typical_of(image, 220.0, depth_m) == pytest.approx(220.0, rel=0.1)


def test_a_thin_part_between_the_coarse_pixels_is_seen_by_fine_rays_and_does_not_contradict():
    row, column, z_m = 6, 20, 4.0
    between_px = column + 0.4, column + 0.6
    left_m, right_m = ((px - CAMERA.cx) / CAMERA.fx * z_m for px in between_px)
    top_m, bottom_m = ((px - CAMERA.cy) / CAMERA.fy * z_m for px in (row - 3.5, row + 3.5))
    corners = np.array(
        [(left_m, top_m, z_m), (left_m, bottom_m, z_m), (right_m, bottom_m, z_m), (right_m, top_m, z_m)]
    )
    strip_m = POSE.inv().apply(corners)[[[0, 1, 2], [0, 2, 3]]]
    with_strip = replace(TARGET, triangles_m=np.concatenate((TARGET.triangles_m, strip_m)))
    coarse = rendered(target=with_strip)
    assert (coarse.triangle < len(TARGET.triangles_m)).all()  # no coarse ray meets the strip
    range_m, sigma_m, shade = seen()
    range_m[row - 3 : row + 4, column] = z_m / RAYS.components[2, row - 3 : row + 4, column]
    images = SeenPixels(range_m, sigma_m, shade)
    size = {"width": STRIDE * CAMERA.width, "height": STRIDE * CAMERA.height}
    lens = {name: STRIDE * getattr(CAMERA, name) for name in ("fx", "fy", "cx", "cy")}
    grid = RayGrid.pinhole(CAMERA.model_copy(update=size | lens))
    fine = FineRanges(cast(grid, with_strip.triangles_m, POSE, cull_back_faces=True).range_m, 1, 0, 0)
    assert contradictions(images, coarse, LIMITS, **SEEN).inconsistent == 7
    assert contradictions(images, coarse, LIMITS, **SEEN, fine=fine).inconsistent == 0
