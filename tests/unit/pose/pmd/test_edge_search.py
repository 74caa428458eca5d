from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.pmd_frames import CAMERA

from rpod_geometry.lens import distort
from rpod_pose.pmd.joint.edge_model import EdgeModel
from rpod_pose.pmd.joint.edge_search import Lens, Profile, imaged, steepest
from rpod_target import load_target

HEXAGON, MOCKUP = load_target("hexagonal-body"), load_target("mockup")
PINHOLE = Lens(CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)
SLOPES = st.floats(-0.25, 0.25)


@given(SLOPES, SLOPES)
def test_a_slope_is_imaged_as_the_lens_does_with_its_derivatives(x: float, y: float) -> None:
    lens = PINHOLE._replace(k1=0.2, k2=-0.1, p1=0.01, p2=-0.02, k3=0.05)
    camera = CAMERA.model_copy(update={"distortion": np.array(lens[4:])})
    column, row, *derivatives = imaged(x, y, lens)
    u, v = distort(np.array((x, y)), camera)
    assert (column, row) == pytest.approx((u * CAMERA.fx + CAMERA.cx, v * CAMERA.fy + CAMERA.cy))
    h = 1e-6
    across = (np.array(imaged(x + h, y, lens)[:2]) - imaged(x - h, y, lens)[:2]) / (2 * h)
    down = (np.array(imaged(x, y + h, lens)[:2]) - imaged(x, y - h, lens)[:2]) / (2 * h)
    assert derivatives == pytest.approx([across[0], down[0], across[1], down[1]], rel=1e-5, abs=1e-3)


@given(st.floats(-2.5, 2.5), st.floats(0.0, 2.0 * np.pi))
def test_a_step_is_found_to_a_tenth_of_a_pixel(place: float, direction: float) -> None:
    across, down = np.cos(direction), np.sin(direction)
    columns, rows = np.meshgrid(np.arange(40.0), np.arange(40.0))
    along = (columns - 20.0) * across + (rows - 20.0) * down - place
    image = (100.0 + 50.0 * np.tanh(along)).astype(np.float32)
    found, change = steepest(image, Profile(20.0, 20.0, across, down), 5.0, 5.0)
    assert found == pytest.approx(place, abs=0.1)
    assert change > 50.0


@pytest.mark.parametrize(("image", "column"), [(np.full((40, 40), 7.0), 20.0), (np.eye(40), 1.0)])
def test_a_clipped_area_and_the_image_border_are_not_asked(image: np.ndarray, column: float) -> None:
    assert steepest(image.astype(np.float32), Profile(column, 20.0, 1.0, 0.0), 5.0, 0.5)[1] < 0.0


def test_noise_below_the_least_contrast_is_no_edge() -> None:
    image = np.random.default_rng(1).normal(100.0, 1.0, (40, 40)).astype(np.float32)
    assert steepest(image, Profile(20.0, 20.0, 1.0, 0.0), 5.0, 20.0) == (0.0, 0.0)


def lengths_m(model: EdgeModel, spacing_m: float) -> float:
    return len(model.places_m) * spacing_m


def test_a_prism_is_drawn_by_its_creases_alone() -> None:
    model = EdgeModel.of(HEXAGON, spacing_m=0.01)
    corners_m = HEXAGON.triangles_m.reshape(-1, 3)
    circumradius_m, length_m = np.linalg.norm(corners_m[:, 1:], axis=1).max(), np.ptp(corners_m[:, 0])
    assert lengths_m(model, 0.01) == pytest.approx(12.0 * circumradius_m + 6.0 * length_m, rel=0.02)


def test_boundaries_between_materials_are_drawn_and_curved_surfaces_are_not() -> None:
    model = EdgeModel.of(MOCKUP, spacing_m=0.02)
    front = np.isclose(model.places_m[:, 0], 0.0) & (np.linalg.norm(model.places_m[:, 1:], axis=1) < 0.4)
    alike = np.einsum("ij,ij->i", model.normals[:, 0], model.normals[:, 1]) > 0.999
    assert (front & alike).any()
    nose = (model.places_m[:, 0] > 0.26) & (model.places_m[:, 0] < 0.39)
    assert not nose.any()
    one = replace(MOCKUP, triangle_material=np.zeros_like(MOCKUP.triangle_material))
    assert lengths_m(EdgeModel.of(one, spacing_m=0.02), 0.02) < lengths_m(model, 0.02)
