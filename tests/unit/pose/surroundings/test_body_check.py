"""A known body that is not where its pose says: told with its offset; one that is hidden or dark is not."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from rpod_geometry.rays import RayGrid, cast
from rpod_pose.surroundings.bodies import KnownBodies, Surface, placed
from rpod_pose.surroundings.body_check import FRAMES, BodyBook, BodyState, Sighting, sighting, warning_of
from rpod_pose.surroundings.separation import RangeImage
from rpod_schemas.config.surroundings import KnownBody
from rpod_schemas.poses import make_pose

ANGLES = np.radians(np.arange(-20.0, 20.0, 0.25))
GRID = RayGrid.azimuth_elevation(ANGLES, ANGLES)
LIMB = trimesh.creation.cylinder(radius=0.12, height=1.6, sections=48)
ANNOUNCED = make_pose(rotation=Rotation.from_euler("x", 70, degrees=True), translation_m=(0.2, 0.1, 3.0))
SIGMA_M = 0.01


def frame(*shapes, grid=GRID):
    """Ranges of the nearest of some shapes, each a mesh and its pose, with noise."""
    ranges_m = [
        cast(grid, np.ascontiguousarray(mesh.triangles, np.float64), pose).range_m for mesh, pose in shapes
    ]
    range_m = np.min([np.full(grid.shape, np.inf), *ranges_m], axis=0)
    noise_m = np.random.default_rng(1).normal(0.0, SIGMA_M, grid.shape)
    return RangeImage(grid, np.where(np.isfinite(range_m), range_m + noise_m, 0.0).astype(np.float32))


def seen(image, tmp_path, tolerance_m=0.05) -> Sighting:
    surface = Surface.of("limb", body(tmp_path, tolerance_m), tmp_path)
    return sighting("limb", image, placed(image, surface, make_pose()))


def body(tmp_path, tolerance_m=0.05) -> KnownBody:
    LIMB.export(tmp_path / "limb.stl")
    return KnownBody(file="limb.stl", metres_per_unit=1.0, pose=ANNOUNCED, tolerance_m=tolerance_m)


def moved(x, y, z):
    """The limb at an offset from its announced pose."""
    place_m = ANNOUNCED.translation + np.array([x, y, z])
    return make_pose(rotation=ANNOUNCED.rotation, translation_m=place_m)


def wall(distance_m):
    return trimesh.creation.box((8.0, 8.0, 0.1)), make_pose(translation_m=(0.0, 0.0, distance_m))


@pytest.mark.parametrize("around", [(), (wall(4.0),)], ids=["alone", "before a wall"])
@pytest.mark.parametrize("off", [(0.0, 0.0, 0.0), (0.04, 0.0, 0.0), (0.0, 0.0, 0.04)])
def test_a_body_that_is_off_by_less_than_its_tolerance_is_in_its_place(around, off, tmp_path):
    found = seen(frame((LIMB, moved(*off)), *around), tmp_path)
    assert found.state is BodyState.IN_PLACE
    assert found.rays > 1000


@pytest.mark.parametrize("around", [(), (wall(4.0),)], ids=["alone", "before a wall"])
@pytest.mark.parametrize("off", [(0.25, 0.0, 0.0), (-0.2, 0.0, 0.2), (0.0, 0.0, 0.3), (0.0, 0.0, -0.25)])
def test_a_body_elsewhere_is_told_with_its_offset(around, off, tmp_path):
    found = seen(frame((LIMB, moved(*off)), *around), tmp_path)
    assert found.state is BodyState.ELSEWHERE
    np.testing.assert_allclose(found.offset_m, off, atol=0.09)
    text = warning_of("pmd", found, np.eye(3))
    x, y, z = found.offset_m
    assert f"sees the known body limb {np.linalg.norm(found.offset_m):.2f} m away" in text
    assert f"x {x:+.2f}, y {y:+.2f}, z {z:+.2f} m in the chaser's axes" in text
    assert "check the encoders" in text
    assert "tolerance_m (0.05)" in text


def test_an_encoder_that_is_off_by_twenty_degrees_is_told_though_no_shift_explains_it(tmp_path):
    shoulder = ANNOUNCED.translation + ANNOUNCED.rotation.apply((0.0, 0.0, -0.8))
    turn = Rotation.from_euler("z", 20.0, degrees=True)
    position_m = shoulder + turn.apply(ANNOUNCED.translation - shoulder)
    actual = make_pose(rotation=turn * ANNOUNCED.rotation, translation_m=position_m)
    found = seen(frame((LIMB, actual), wall(4.0)), tmp_path)
    assert found.state is BodyState.ELSEWHERE
    assert found.in_place < 0.5 * found.rays


def test_a_body_that_is_not_there_is_told_by_the_rays_that_end_beyond_it(tmp_path):
    found = seen(frame(wall(4.0)), tmp_path)
    assert (found.state, found.offset_m, found.in_place) == (BodyState.ELSEWHERE, None, 0)
    assert f"of {found.rays} rays that should meet it {found.rays} end beyond it" in warning_of(
        "p", found, np.eye(3)
    )


def test_a_wall_close_behind_an_absent_body_is_not_taken_for_it(tmp_path):
    assert seen(frame(wall(3.3)), tmp_path).offset_m is None


def test_a_dark_body_is_not_seen_and_not_contradicted(tmp_path):
    found = seen(frame(), tmp_path)
    assert (found.state, found.missing) == (BodyState.UNSEEN, found.rays)
    assert "its pose is not checked" in warning_of("pmd", found, np.eye(3))


@pytest.mark.parametrize("distance_m", [1.5, 2.6])
def test_a_body_that_something_larger_hides_is_not_judged(distance_m, tmp_path):
    box = trimesh.creation.box((1.4, 1.4, 0.4))
    hiding = box, make_pose(translation_m=(0.0, 0.0, distance_m))
    found = seen(frame((LIMB, ANNOUNCED), hiding), tmp_path)
    assert found.offset_m is None
    assert found.state in (BodyState.HIDDEN, BodyState.IN_PLACE)


def test_a_state_changes_after_frames_in_a_row_of_one_sensor_and_hidden_ones_do_not_count():
    book, axes = BodyBook(), np.eye(3)
    away = Sighting("limb", BodyState.ELSEWHERE, 0.05, 100, 10, 90)
    for frames in range(FRAMES - 1):
        book.take("pmd", away, axes)
        book.take("pmd", Sighting("limb", BodyState.HIDDEN, 0.05), axes)
        book.take("lidar", Sighting("limb", BodyState.IN_PLACE, 0.05, 50, 50, 0), axes)
        assert {state for *_, state, _ in book.states} == {BodyState.IN_PLACE}, frames
    book.take("pmd", away, axes)
    assert [(sensor, state) for _, sensor, state, text in book.states if text] == [
        ("pmd", BodyState.ELSEWHERE)
    ]
    assert book.counts["limb", "pmd", BodyState.ELSEWHERE] == FRAMES
    for _ in range(FRAMES):
        book.take("pmd", Sighting("limb", BodyState.IN_PLACE, 0.05, 100, 100, 0), axes)
    assert not any(text for *_, text in book.states)


def test_a_body_that_is_seen_elsewhere_hides_nothing_until_it_is_in_its_place_again(tmp_path):
    known = KnownBodies.of({"limb": body(tmp_path)}, tmp_path)
    away, right = (frame((LIMB, moved(x, 0.0, 0.0)), wall(4.0)) for x in (0.25, 0.0))
    hidden = [known.hiding(away, stamp, make_pose(), "pmd").sum() for stamp in range(FRAMES + 1)]
    assert [count > 0 for count in hidden] == [True] * (FRAMES - 1) + [False] * 2
    assert known.hiding(right, 9, make_pose(), "pmd").sum() > 0
    assert known.hiding(away, 10, make_pose(), "pmd").sum() == 0
    assert known.hiding(away, 11, make_pose(), "lidar").sum() > 0
