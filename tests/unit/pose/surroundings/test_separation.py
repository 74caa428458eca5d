"""What a pose says of the rays around it, and where in a frame a target may be."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_geometry.rays import RayGrid, cast
from rpod_pose.pmd import depth_view
from rpod_pose.pmd.depth_view import DepthView
from rpod_pose.pmd.other_things import PmdFrames
from rpod_pose.ports import Registration
from rpod_pose.surroundings import sight
from rpod_pose.surroundings.places import around_place, places
from rpod_pose.surroundings.separation import Every, Label, RangeImage, Spans
from rpod_pose.surroundings.sight import Margin as Errors
from rpod_pose.surroundings.sight import Sight, with_target_at
from rpod_pose.surroundings.tracker import _checked
from rpod_schemas.poses import make_pose
from rpod_schemas.types import BeliefLevel, Camera, PmdFrame, Source
from rpod_target import load_target

TARGET = load_target("mockup")
POSE = make_pose(rotation=Rotation.from_euler("ZYX", [20, 60, 10], degrees=True), translation_m=(0.1, 0, 4))
GRID = RayGrid.pinhole(Camera(width=176, height=144, fx=341.0, fy=341.0, cx=87.5, cy=71.5))
ERRORS = Errors(0.06, 0.06)


def seen() -> np.ndarray:
    """Return the ranges of a frame that shows the target alone, 0 without one."""
    range_m = cast(GRID, TARGET.triangles_m, POSE).range_m
    return np.where(np.isfinite(range_m), range_m, 0.0).astype(np.float32)


def beside(range_m: np.ndarray, last_row: int) -> np.ndarray:
    """Return ranges with a limb above the target's middle, from the target up to a row."""
    column = round(87.5 + 341.0 * 0.1 / 4.0)
    top = int(np.flatnonzero(range_m[:, column])[0])
    with_limb = range_m.copy()
    with_limb[last_row:top, column - 6 : column + 7] = 4.0
    return with_limb


def test_a_thing_at_the_images_border_is_no_detail_of_the_target_since_it_may_go_on():
    alone = with_target_at(RangeImage(GRID, seen()), TARGET, POSE, ERRORS)
    ending = with_target_at(RangeImage(GRID, beside(seen(), 3)), TARGET, POSE, ERRORS)
    going_on = with_target_at(RangeImage(GRID, beside(seen(), 0)), TARGET, POSE, ERRORS)
    assert alone.unexplained == 0
    assert ending.unexplained > 50
    assert going_on.unexplained == 0


@pytest.mark.parametrize("bias_m", [-0.4, 0.4])
def test_an_error_that_all_ranges_share_hides_nothing_of_the_target_once_it_is_known(bias_m):
    range_m = seen()
    biased = RangeImage(GRID, np.where(range_m > 0.0, range_m + np.float32(bias_m), np.float32(0.0)))
    met = range_m > 0.0
    uncorrected = with_target_at(biased, TARGET, POSE, ERRORS).labels[met]
    corrected = with_target_at(biased.corrected(bias_m), TARGET, POSE, ERRORS).labels[met]
    assert np.mean(uncorrected == Label.KEPT) < 0.5
    assert np.mean(corrected == Label.KEPT) > 0.99


def test_a_surface_that_the_border_cuts_is_searched_without_its_limb_first_and_then_with_it():
    limb = beside(seen(), 0)
    found = list(places(RangeImage(GRID, limb), TARGET.radius_m))
    assert len(found) == 2
    without, whole = found
    assert (whole == (limb > 0.0)).mean() > 0.999
    assert not without[0].any()
    assert np.count_nonzero(without) > 0.7 * np.count_nonzero(seen())
    assert len(list(places(RangeImage(GRID, beside(seen(), 3)), TARGET.radius_m))) == 1


def test_surfaces_that_together_have_the_targets_size_are_searched_as_one_without_stray_ranges():
    """A body with a gap in range, such as a panel before it, is seen as two surfaces."""
    range_m = seen()
    rows, columns = np.nonzero(range_m)
    upper = rows < np.median(rows)
    range_m[rows[upper], columns[upper]] -= np.float32(0.6 * TARGET.radius_m)
    whole = range_m > 0.0
    range_m[2, 3] = range_m[rows.max(), columns[rows.argmax()]]
    first, *others = places(RangeImage(GRID, range_m), TARGET.radius_m)
    np.testing.assert_array_equal(first, whole)
    assert len(others) == 2
    np.testing.assert_array_equal(others[0] | others[1], whole)


@pytest.mark.parametrize("bias_m", [-0.1, 0.1])
def test_a_ray_without_a_range_hides_nothing_whatever_error_the_ranges_share(bias_m):
    range_m = np.where(seen() > 0.0, seen() + np.float32(bias_m), np.float32(0.0))
    range_m[:, ::2] = 0.0
    image = RangeImage(GRID, range_m).corrected(bias_m)
    np.testing.assert_array_equal(image.range_m > 0.0, range_m > 0.0)
    assert with_target_at(image, TARGET, POSE, ERRORS).visible_share > 0.99


def test_what_goes_on_beyond_the_targets_reach_tells_nothing_of_its_outline():
    range_m = seen()
    column = round(87.5 + 341.0 * 0.1 / 4.0)
    top = int(np.flatnonzero(range_m[:, column])[0])
    limb = np.zeros(range_m.shape, bool)
    limb[:top, column - 2 : column + 7] = range_m[:top, column - 2 : column + 7] == 0.0
    with_limb = np.where(limb, range_m[top, column], range_m)
    alone, held = (
        with_target_at(RangeImage(GRID, each), TARGET, POSE, ERRORS) for each in (range_m, with_limb)
    )
    reached = limb & (held.labels != Label.BEYOND)
    assert np.mean(held.labels[reached] == Label.KEPT) < 0.05
    assert (limb & (held.labels == Label.HIDING)).any()
    np.testing.assert_array_equal(held.labels[~limb], alone.labels[~limb])
    assert held.visible_share == alone.visible_share
    limb[: top - 4] = False  # it ends within reach, as a detail of the target does
    ending = with_target_at(RangeImage(GRID, np.where(limb, with_limb, range_m)), TARGET, POSE, ERRORS)
    assert (limb & (ending.labels == Label.KEPT)).any()


def test_a_noisy_range_of_the_target_neither_hides_it_nor_passes_it():
    range_m, generator = seen(), np.random.default_rng(2)
    noisy = np.where(range_m > 0.0, range_m + generator.normal(0.0, 0.2, range_m.shape), 0.0)
    sigma_m = np.full(range_m.shape, 0.2, np.float32)
    unknown, known = (
        with_target_at(RangeImage(GRID, noisy.astype(np.float32), sigma_m=each), TARGET, POSE, ERRORS)
        for each in (None, sigma_m)
    )
    on_target = range_m > 0.0
    assert np.mean(unknown.labels[on_target] == Label.KEPT) < 0.8
    assert np.mean(known.labels[on_target] == Label.KEPT) > 0.99


def test_a_thin_body_that_an_arm_prolongs_is_searched_without_most_of_the_arm_too():
    range_m, radius_m = np.zeros(GRID.shape, np.float32), 0.5
    range_m[:105, 82:95] = 4.0  # 1.2 m x 0.15 m, from the image's border
    range_m[60:105, 82:95] = 3.95
    whole, part, *_ = places(RangeImage(GRID, range_m), radius_m)
    np.testing.assert_array_equal(whole, range_m > 0.0)
    assert not part[:10].any()
    assert part[75:105].sum() > 0.9 * np.count_nonzero(range_m[75:105])


@pytest.mark.parametrize("size", [(352, 287), (640, 480), (512, 512), (1024, 1024), (641, 481)])
def test_a_target_before_a_wall_is_kept_whatever_the_size_of_the_image(size):
    width, height = size
    camera = Camera(width=width, height=height, fx=0.9 * width, fy=0.9 * width, cx=width / 2, cy=height / 2)
    grid = RayGrid.pinhole(camera)
    hits = cast(grid, TARGET.triangles_m, make_pose(translation_m=(0.3, 0.2, 5.0)))
    met = hits.triangle >= 0
    depth_m = np.where(met, hits.range_m * grid.components[2], 9.0).astype(np.float32)
    bright = np.full(depth_m.shape, 500, np.uint16)
    frame = PmdFrame(stamp_ns=1, frame_id="", depth_m=depth_m, amplitude=bright, camera=camera)
    frames = PmdFrames()
    coarse, fine = (frames.image(frame, fine=each) for each in (False, True))
    place = next(places(coarse, TARGET.radius_m))
    labels = around_place(coarse, fine, place, TARGET.radius_m)
    separated = frames.separated(frame, labels, np.zeros(labels.shape, bool))
    kept = np.isfinite(separated.depth_m)
    assert np.count_nonzero(kept & met) > 0.98 * np.count_nonzero(met)
    assert np.count_nonzero(kept & ~met) < 0.02 * np.count_nonzero(met)


def test_each_ray_takes_the_value_of_the_nearest_of_few_rays():
    coarse, fine = Every(7, 3), Every(2, 1)
    assert coarse.nearest(fine, 8, 99).tolist() == [0, 0, 0, 1, 1, 1, 1, 2]  # pixels 1, 3 to 15
    assert coarse.nearest(fine, 8, 1).tolist() == [0, 0, 0, 1, 1, 1, 1, 1]


def wide_scan(rows_deg: float, columns_deg: float, up_deg: float = 20.0) -> RangeImage:
    """Return the ranges of a scan that sees the target, and a second one far above it."""
    azimuth, elevation = (np.radians(np.arange(-up_deg, up_deg, each)) for each in (columns_deg, rows_deg))
    grid = RayGrid.azimuth_elevation(azimuth, elevation)
    upper = make_pose(translation_m=(0.0, -2.4, 10.0))
    range_m = np.minimum(*(cast(grid, TARGET.triangles_m, pose).range_m for pose in (AHEAD, upper)))
    return RangeImage(grid, np.where(np.isfinite(range_m), range_m, 0.0).astype(np.float32))


AHEAD = make_pose(translation_m=(0.0, 0.0, 10.0))


def test_a_margin_is_as_wide_across_rows_as_across_columns_that_are_closer():
    image = wide_scan(2.0, 0.2)
    assert image.rays_across(0.7, 10.0) == Spans(rows=3, columns=21)
    sight = with_target_at(image, TARGET, AHEAD, Errors(0.2, 0.2))
    second = (image.range_m > 0.0) & (image.points_m[..., 1] < -1.8)
    assert np.count_nonzero(second) > 10
    assert (sight.labels[second] == Label.BEYOND).all()


def test_a_margin_of_a_near_target_is_as_wide_as_that_of_a_remote_one():
    near = RangeImage(GRID, seen())
    assert near.rays_across(0.4, 1.0).columns == pytest.approx(0.4 * 341.0, abs=1.0)
    assert near.rays_across(400.0, 1.0) == Spans(144, 176)


@pytest.mark.parametrize(("azimuth_deg", "share"), [(0.0, 1.0), (95.0, 1.0), (180.0, 1.0), (250.0, 0.0)])
def test_points_beside_and_behind_a_lidar_are_in_view_where_it_has_rays(azimuth_deg, share):
    grid = RayGrid.azimuth_elevation(np.radians(np.arange(-30, 201, 1.0)), np.radians(np.arange(-20, 21, 2)))
    image = RangeImage(grid, np.zeros(grid.shape, np.float32))
    turn = Rotation.from_euler("y", azimuth_deg, degrees=True)
    points_m = turn.apply([[0.3, 0.2, 6.0], [-0.3, -0.5, 5.0], [0.0, 0.4, 7.0]])
    assert image.in_view(points_m) == share


def test_a_lens_is_inverted_once_for_all_views_of_a_camera(monkeypatch):
    made = []
    pinhole = RayGrid.pinhole
    monkeypatch.setattr(depth_view.RayGrid, "pinhole", lambda *args: made.append(args) or pinhole(*args))
    lens = np.array([0.5, 0.1, 1e-4, 0.0, 0.02, 0.8, 0.2, 0.05])
    camera = Camera(width=97, height=61, fx=60.0, fy=61.0, cx=47.0, cy=31.0, distortion=lens)
    views = [DepthView.of(camera, stride) for stride in range(1, 12)]
    assert len(made) == 1
    for view in views:
        every = (slice(view.offset, None, view.stride),) * 2
        slopes = view.coarse.components[:2] / view.coarse.components[2]
        assert np.allclose(np.moveaxis(slopes, 0, -1), view.slopes[every], atol=1e-12)


@pytest.mark.parametrize(
    "place_m", [(0.1, 0, 4), (1.0, -0.8, 4), (-2.5, 0, 6), (9, 0, 4), (0, 0, 0.8), (0, 0, -3)]
)
@pytest.mark.parametrize(
    "grid", [GRID, RayGrid.azimuth_elevation(np.radians(np.arange(-30, 31)), np.radians(np.arange(20)))]
)
def test_rays_are_compared_around_the_target_alone_with_the_same_result(monkeypatch, place_m, grid):
    """The target is in view, cut by the border, outside, around the sensor, and behind it."""
    generator, pose = np.random.default_rng(1), make_pose(rotation=POSE.rotation, translation_m=place_m)
    range_m = cast(grid, TARGET.triangles_m, pose).range_m
    range_m = np.where(np.isfinite(range_m), range_m, np.float32(5.0)).astype(np.float32)
    range_m[generator.random(grid.shape) < 0.1] = 0.0
    range_m[5:12, 10:30] = np.float32(np.linalg.norm(place_m))
    image = RangeImage(grid, range_m, generator.random(grid.shape) < 0.1)
    around = with_target_at(image, TARGET, pose, ERRORS)
    everywhere = slice(None), slice(None)
    monkeypatch.setattr(sight, "window_around", lambda *_: everywhere)
    monkeypatch.setattr(sight, "_window_of_ball", lambda *_: everywhere)
    for name, value in vars(with_target_at(image, TARGET, pose, ERRORS)).items():
        np.testing.assert_array_equal(getattr(around, name), value, name)


@pytest.mark.parametrize(
    ("source", "elsewhere", "level"),
    [
        (Source.PMD_AMPLITUDE, 41, BeliefLevel.DOUBTFUL),
        (Source.PMD_AMPLITUDE, 36, BeliefLevel.ACCEPTED),
        (Source.PMD_JOINT, 41, BeliefLevel.ACCEPTED),
    ],
)
def test_a_pose_by_the_amplitude_alone_is_not_sure_where_most_ranges_are_on_other_things(
    source, elsewhere, level
):
    """The edges that are in their place may be those of the other things."""
    nothing = np.zeros((1, 1), np.uint8)
    shown = Sight(nothing, nothing > 0, 0.6, 36, 0.02, elsewhere, 0, 0, 0.0)
    found = _checked(Registration(source, T_sensor_target=make_pose()), shown, most_unexplained=6)
    assert found.belief.level is level
    assert ("41 are on other things, 36 on the target" in found.belief.reason) == (
        level is BeliefLevel.DOUBTFUL
    )
    assert found.continues_track
    assert found.begins_track == (level is BeliefLevel.ACCEPTED)
