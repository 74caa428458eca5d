from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from tests.pmd_frames import CAMERA

from rpod_pose.pmd.depth_view import DepthView
from rpod_pose.pmd.joint.brightness.patch_renderer import Appearance, PatchRenderer, light_of
from rpod_pose.pmd.joint.edge_model import EdgeModel
from rpod_pose.pmd.joint.edge_search import NOT_SATURATED, Lens, Patch
from rpod_pose.pmd.joint.expected_edges import (
    ExpectedEdges,
    add_in_place,
    expect_edges,
    shown_probability,
)
from rpod_pose.pmd.joint.frame import moved_px
from rpod_pose.registration.lie_group import PoseArrays
from rpod_schemas.config.pmd.joint import JointEdgeConfig
from rpod_schemas.poses import make_pose
from rpod_target import Target, load_target

LENS = Lens(CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)
HEXAGON = load_target("hexagonal-body")
AHEAD = make_pose(translation_m=(0.0, 0.0, 4.0))
DARK = np.zeros((CAMERA.height, CAMERA.width), np.float32)


def expected(
    target: Target,
    T: RigidTransform = AHEAD,
    *,
    hider: Target | None = None,
    noise: float = 0.5,
    per_px: int = 2,
    image: np.ndarray = DARK,
    unranged: np.ndarray = NOT_SATURATED,
) -> tuple[EdgeModel, ExpectedEdges]:
    """Return a target's edges, and those expected at a pose behind another body."""
    model = EdgeModel.of(target, spacing_m=0.02)
    patch = Patch(image, image, 0.0, 0.0, max(6.0, 3.0 * noise), noise, 100.0, unranged=unranged)
    renderer = PatchRenderer(target if hider is None else hider, JointEdgeConfig())
    shown = renderer.render(
        DepthView.of(CAMERA, 4).rays(per_px).arrays, per_px, PoseArrays.of(T), patch
    ).shown
    assert shown.shade.shape == shown.fitted.shape == shown.window[2:]
    return model, expect_edges(model.arrays, LENS, patch, shown)


def likely(seen: ExpectedEdges) -> np.ndarray:
    return seen.sample[seen.probability >= 0.5]


def test_edges_of_faces_that_are_turned_away_are_not_expected() -> None:
    model, seen = expected(HEXAGON)
    towards = -AHEAD.translation - model.places_m
    faces = np.einsum("nsk,nk->ns", model.normals, towards)
    assert 0 < len(seen.sample) < len(model.places_m)
    assert (faces[seen.sample].max(axis=1) > 0.0).all()
    assert len(likely(seen)) > 0.8 * len(seen.sample)


def test_what_stands_before_an_edge_hides_it() -> None:
    wall_m = HEXAGON.triangles_m * (1.0, 3.0, 3.0) - (0.0, 0.0, 1.0)
    _, seen = expected(HEXAGON, hider=replace(HEXAGON, triangles_m=wall_m))
    assert len(seen.sample) == 0


@pytest.mark.parametrize(("per_px", "off_px"), [(1, 0.3), (2, 0.15)])
def test_an_edge_that_stands_alone_is_expected_in_its_place(per_px: int, off_px: float) -> None:
    _, seen = expected(HEXAGON, per_px=per_px)
    assert np.median(np.abs(seen.place)) < off_px


@pytest.mark.parametrize("per_px", [1, 2])
def test_a_displacement_by_a_neighbour_below_a_quarter_pixel_is_expected(per_px: int) -> None:
    """A rendering with 64 rays in each pixel shows it; one ray, or four in rows and columns, did not."""
    far = make_pose(rotation=Rotation.from_rotvec((0.3, 0.5, 0.2)), translation_m=(0.0, 0.0, 14.0))
    image, patch = DARK.copy(), Patch(DARK, DARK, 0.0, 0.0, 6.0, 0.5, 0.0)
    rays, renderer = DepthView.of(CAMERA, 4).rays(8).arrays, PatchRenderer(HEXAGON, JointEdgeConfig())
    shown = renderer.render(rays, 8, PoseArrays.of(far), patch).shown
    window = shown.window
    rows = slice(window.row, window.row + window.rows)
    image[rows, window.column : window.column + window.columns] = shown.shade * (100.0 / shown.typical)
    dense, few = (
        {int(n): place for n, place in zip(seen.sample, seen.place, strict=True)}
        for seen in (expected(HEXAGON, far, per_px=each, image=image)[1] for each in (8, per_px))
    )
    both = np.array([(dense[n], few[n]) for n in dense.keys() & few.keys() if 0.08 < abs(dense[n]) < 0.25])
    assert len(both) > 5
    assert np.median(both[:, 1] / both[:, 0]) == pytest.approx(1.0, abs=0.15)
    assert np.sqrt(np.mean(np.diff(both) ** 2)) < 0.05


def test_the_brightness_of_a_face_follows_lamberts_law_at_each_ray() -> None:
    turned = make_pose(rotation=Rotation.from_rotvec((0.9, 0.2, 0.0)), translation_m=(0.2, 0.0, 3.0))
    grid, pose = DepthView.of(CAMERA, 4).rays(1), PoseArrays.of(turned)
    renderer, appearance = PatchRenderer(HEXAGON, JointEdgeConfig()), Appearance.of(HEXAGON)
    hits, light = renderer.cast(grid.arrays, pose), light_of(appearance, pose)
    met = hits.triangle >= 0
    triangle, range_m, rays = hits.triangle[met], hits.range_m[met], grid.directions[met]
    cosine = np.abs(np.einsum("ni,ni->n", appearance.normals[triangle] @ pose.R.T, rays))
    np.testing.assert_allclose(
        light[triangle] / range_m**3, appearance.albedo[triangle] * cosine / range_m**2, rtol=1e-3
    )


def test_the_motion_since_the_rendering_is_that_of_the_outline() -> None:
    before = PoseArrays.of(AHEAD)
    turned = make_pose(rotation=Rotation.from_rotvec((0.0, 0.0, 0.01)), translation_m=AHEAD.translation)
    shifted = make_pose(translation_m=(0.02, 0.0, 4.0))
    assert moved_px(before, before, 1.0, LENS.fx / 4.0) == pytest.approx(0.0, abs=1e-6)
    assert moved_px(before, PoseArrays.of(turned), 1.5, LENS.fx / 4.0) == pytest.approx(
        0.01 * 1.5 * LENS.fx / 4.0, rel=1e-3
    )
    assert moved_px(before, PoseArrays.of(shifted), 0.0, LENS.fx / 4.0) == pytest.approx(0.02 * LENS.fx / 4.0)


def test_edges_closer_than_a_pixel_are_one_change() -> None:
    far = make_pose(translation_m=(0.0, 0.0, 40.0))
    _, near = expected(HEXAGON)
    _, small = expected(HEXAGON, far)
    assert len(small.sample) < 0.5 * len(near.sample)


@pytest.mark.parametrize(("noise", "share"), [(0.5, (0.8, 1.0)), (60.0, (0.0, 0.1))])
def test_the_noise_of_the_image_decides_what_is_expected_to_be_seen(
    noise: float, share: tuple[float, float]
) -> None:
    _, seen = expected(HEXAGON, noise=noise)
    assert share[0] <= len(likely(seen)) / len(seen.sample) <= share[1]


@pytest.mark.parametrize("spread", [0.2, 0.5, 2.0])
@pytest.mark.parametrize("change", [1.8, 4.0, 6.0, 9.0, 20.0])
def test_a_change_is_shown_as_often_as_materials_and_noise_let_it(change: float, spread: float) -> None:
    drawn = np.random.default_rng(1).standard_normal((2, 20_000))
    share = (change * np.exp(spread * drawn[0]) + 2.0 * drawn[1] > 6.0).mean()
    assert shown_probability(change, spread, 2.0, 6.0) == pytest.approx(share, abs=0.06)


def test_what_the_rendering_does_not_show_is_not_expected() -> None:
    beside = replace(HEXAGON, triangles_m=HEXAGON.triangles_m + np.array((0.0, 0.3, 0.0)))
    shares = [np.mean(expected(HEXAGON, hider=shown)[1].probability == 0.0) for shown in (HEXAGON, beside)]
    assert shares[0] < 0.2
    assert shares[1] > 0.5


def test_the_outline_before_something_bright_is_known_where_that_has_no_range() -> None:
    bright, none = np.full_like(DARK, 40.0), np.ones(DARK.shape, np.uint8)
    _, seen = expected(HEXAGON, image=bright, unranged=none)
    assert 0.3 < seen.before.mean() < 1.0
    half = none.copy()
    half[:, : CAMERA.width // 2] = 0
    fewer = expected(HEXAGON, image=bright, unranged=half)[1].before
    assert 0.3 * seen.before.sum() < fewer.sum() < 0.7 * seen.before.sum()
    for image, unranged in ((DARK, none), (bright, 0 * none), (bright, NOT_SATURATED)):
        assert not expected(HEXAGON, image=image, unranged=unranged)[1].before.any()


def test_a_missing_edge_counts_by_what_it_tells() -> None:
    certain, doubtful = np.zeros(3), np.zeros(3)
    add_in_place(certain, 0.95, False)
    add_in_place(doubtful, 0.1, False)
    assert certain[1] > 100.0 * doubtful[1]
    add_in_place(certain, 0.95, True)
    assert certain[0] == pytest.approx(-np.log(0.05))
    assert certain[1] == pytest.approx(2.0 * 0.95 * certain[0])
    assert certain[2] == pytest.approx(2.0 * 0.95 * certain[0] ** 2)


def test_nothing_is_expected_outside_the_image() -> None:
    _, seen = expected(HEXAGON, make_pose(translation_m=(30.0, 0.0, 4.0)))
    assert len(seen.sample) == 0
