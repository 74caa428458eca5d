"""Brightness that varies within a surface."""

import numpy as np

from rpod_pose.pmd.joint.brightness.brightness_fit import followed
from rpod_pose.pmd.joint.brightness.local_brightness import local_light
from rpod_pose.pmd.joint.brightness.mixture import Mixture
from rpod_pose.pmd.joint.edge_search import Patch
from rpod_pose.pmd.rendering import Window

ROWS, COLUMNS = 50, 70
ROW, COLUMN = np.mgrid[:ROWS, :COLUMNS].astype(np.float32)


def two_surfaces(edge: int) -> Mixture:
    """Return a window whose columns before ``edge`` show one surface, and the others another."""
    part = (edge <= COLUMN).astype(np.int32)
    pixel = np.arange(part.size, dtype=np.int32)
    light = np.ones(part.size, np.float32)
    return Mixture(Window(0, 0, ROWS, COLUMNS), pixel, part.ravel(), light, part, np.zeros_like(COLUMN))


def test_a_slope_within_a_surface_is_followed_up_to_its_edge() -> None:
    ratio = np.where(COLUMN < 30, 1.0 + 0.01 * (COLUMN - 15) + 0.005 * (ROW - 25), 0.8).astype(np.float32)
    light = local_light(two_surfaces(30), np.ones_like(ratio), ratio).reshape(ratio.shape)
    np.testing.assert_allclose(light, ratio, atol=0.02)


def test_pixels_of_several_surfaces_count_little_beside_those_of_one() -> None:
    weight = np.where(np.abs(COLUMN - 29.5) < 2.0, 0.01, 1.0).astype(np.float32)
    ratio = np.where(weight < 1.0, 2.0, 1.2).astype(np.float32)
    light = local_light(two_surfaces(30), weight, ratio)
    np.testing.assert_allclose(light, 1.2, atol=0.03)


def test_what_has_no_weight_keeps_its_light() -> None:
    light = local_light(two_surfaces(30), np.zeros_like(ROW), np.full_like(ROW, 1.5))
    np.testing.assert_array_equal(light, 1.0)


def test_a_followed_rendering_is_clipped_as_the_image_is() -> None:
    image = (100.0 * (1.0 + 0.02 * COLUMN)).astype(np.float32)
    patch = Patch(np.minimum(image, 180.0), image, 0.0, 0.0, 6.0, 0.5, 100.0)
    shown = followed(patch, two_surfaces(30), np.full(2, 120.0, np.float32), clip=1.8, blur_px=0.8)
    inner = np.s_[4:-4, 4:-4]
    np.testing.assert_allclose(shown[inner], np.minimum(image, 180.0)[inner], rtol=0.03)
