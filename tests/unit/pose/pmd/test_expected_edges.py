from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from tests.pmd_frames import CAMERA

from rpod_geometry.rays import RenderBuffers
from rpod_pose.pmd.depth_view import DepthView
from rpod_pose.pmd.joint.edge_model import EdgeModel
from rpod_pose.pmd.joint.edge_search import Lens, Patch
from rpod_pose.pmd.joint.expected_edges import (
    Appearance,
    EdgeSight,
    ExpectedEdges,
    Fine,
    blur_weights,
    expect_edges,
    moved_px,
)
from rpod_pose.registration.lie_group import PoseArrays
from rpod_schemas.poses import make_pose
from rpod_target import Target, load_target

LENS = Lens(CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)
HEXAGON = load_target("hexagonal-body")
AHEAD = make_pose(translation_m=(0.0, 0.0, 4.0))


def expected(
    target: Target,
    T: RigidTransform = AHEAD,
    *,
    hider: Target | None = None,
    noise: float = 0.5,
    per_px: int = 2,
) -> tuple[EdgeModel, ExpectedEdges, int]:
    """Return a target's edges, those expected at a pose behind another body, and their number."""
    model = EdgeModel.of(target, spacing_m=0.02)
    image = np.zeros((CAMERA.height, CAMERA.width), np.float32)
    patch = Patch(image, 0.0, 0.0, max(6.0, 3.0 * noise), noise, 100.0)
    sight = EdgeSight(model.arrays, LENS, patch, ExpectedEdges.room(len(model.places_m)), 0.3)
    grid = DepthView.of(CAMERA, 4).fine[per_px - 1]
    assert grid.shape == (per_px * CAMERA.height, per_px * CAMERA.width)
    hits = RenderBuffers(np.empty(grid.shape, np.float32), np.empty(grid.shape, np.int32))
    fine = Fine(grid.arrays, per_px, hits, np.empty_like(image), blur_weights(0.8), 4.0)
    body = target if hider is None else hider
    expect_edges(sight, PoseArrays.of(T), Appearance.of(body), fine)
    return model, sight.expected, int(sight.expected.length[0])


def likely(seen: ExpectedEdges, count: int) -> np.ndarray:
    return seen.sample[:count][seen.probability[:count] >= 0.5]


def test_edges_of_faces_that_are_turned_away_are_not_expected() -> None:
    model, seen, count = expected(HEXAGON)
    towards = -AHEAD.translation - model.places_m
    faces = np.einsum("nsk,nk->ns", model.normals, towards)
    assert 0 < count < len(model.places_m)
    assert (faces[seen.sample[:count]].max(axis=1) > 0.0).all()
    assert len(likely(seen, count)) > 0.8 * count


def test_what_stands_before_an_edge_hides_it() -> None:
    wall_m = HEXAGON.triangles_m * (1.0, 3.0, 3.0) - (0.0, 0.0, 1.0)
    _, _, count = expected(HEXAGON, hider=replace(HEXAGON, triangles_m=wall_m))
    assert count == 0


@pytest.mark.parametrize(("per_px", "off_px"), [(1, 0.3), (2, 0.15)])
def test_an_edge_that_stands_alone_is_expected_in_its_place(per_px: int, off_px: float) -> None:
    _, seen, count = expected(HEXAGON, per_px=per_px)
    assert np.median(np.abs(seen.place[:count])) < off_px


def test_the_motion_since_the_rendering_is_that_of_the_outline() -> None:
    model, seen, _ = expected(HEXAGON)
    patch = Patch(np.zeros((1, 1), np.float32), 0.0, 0.0, 1.0, 0.0, 0.0)
    sight = EdgeSight(model.arrays, LENS, patch, seen, 0.3)
    turned = make_pose(rotation=Rotation.from_rotvec((0.0, 0.0, 0.01)), translation_m=AHEAD.translation)
    shifted = make_pose(translation_m=(0.02, 0.0, 4.0))
    assert moved_px(sight, PoseArrays.of(AHEAD), HEXAGON.radius_m) == pytest.approx(0.0, abs=1e-6)
    expected_px = 0.01 * HEXAGON.radius_m * LENS.fx / 4.0
    assert moved_px(sight, PoseArrays.of(turned), HEXAGON.radius_m) == pytest.approx(expected_px, rel=1e-3)
    assert moved_px(sight, PoseArrays.of(shifted), 0.0) == pytest.approx(0.02 * LENS.fx / 4.0)
    assert np.isnan(moved_px(sight._replace(expected=ExpectedEdges.room(1)), PoseArrays.of(AHEAD), 1.0))


def test_edges_closer_than_a_pixel_are_one_change() -> None:
    far = make_pose(translation_m=(0.0, 0.0, 40.0))
    _, _, near_count = expected(HEXAGON)
    _, _, far_count = expected(HEXAGON, far)
    assert far_count < 0.5 * near_count


@pytest.mark.parametrize(("noise", "share"), [(0.5, (0.8, 1.0)), (60.0, (0.0, 0.1))])
def test_the_noise_of_the_image_decides_what_is_expected_to_be_seen(
    noise: float, share: tuple[float, float]
) -> None:
    _, seen, count = expected(HEXAGON, noise=noise)
    assert share[0] <= len(likely(seen, count)) / count <= share[1]


def test_nothing_is_expected_outside_the_image() -> None:
    _, _, count = expected(HEXAGON, make_pose(translation_m=(30.0, 0.0, 4.0)))
    assert count == 0
