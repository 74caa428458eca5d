"""Parts that the pixels of a rendering show, and the brightness that is fitted to them."""

import cv2
import numpy as np
import pytest

from rpod_geometry.rays import RenderBuffers
from rpod_pose.pmd.joint.brightness_fit import (
    Behind,
    Mixture,
    adapt,
    clipped,
    misfit,
    mixed,
    mixture_of,
    ratio_of,
    squares_of,
)
from rpod_pose.pmd.joint.edge_search import Patch
from rpod_pose.pmd.joint.patch_renderer import brightness_behind
from rpod_pose.pmd.rendering import SKY_PX, window_of

ROWS, COLUMNS, TRIANGLES = 9, 11, 6


def at_one_metre(triangle: np.ndarray) -> RenderBuffers:
    return RenderBuffers(np.where(triangle >= 0, 1.0, np.inf).astype(np.float32), triangle)


@pytest.mark.parametrize("per_px", [1, 2, 3])
def test_a_pixel_shows_the_light_of_all_its_rays(per_px: int) -> None:
    random = np.random.default_rng(2)
    triangle = random.integers(-1, TRIANGLES, (per_px * ROWS, per_px * COLUMNS)).astype(np.int32)
    triangle[: 4 * per_px] = np.repeat(np.repeat(triangle[:4, :COLUMNS], per_px, 0), per_px, 1)
    light = random.random(TRIANGLES + 1).astype(np.float32)
    part = np.array([0, 0, 1, 2, 2, 3], np.int32)
    hits = at_one_metre(triangle)
    hits.range_m[4 * per_px :] *= 1.0 + random.random((per_px * (ROWS - 4), per_px * COLUMNS))
    mixture = mixture_of(hits, per_px, light, part)
    assert mixture.window == (0, 0, ROWS, COLUMNS)
    image = mixed(np.ones(4, np.float32), mixture, np.float32(np.inf))
    by_ray = np.where(triangle >= 0, light[triangle] / hits.range_m**3, 0.0).reshape(
        ROWS, per_px, COLUMNS, per_px
    )
    np.testing.assert_allclose(image, by_ray.sum(axis=(1, 3)), rtol=1e-6)
    shown = np.where(triangle >= 0, part[triangle], -1).reshape(ROWS, per_px, COLUMNS, per_px)
    least, most = shown.min(axis=(1, 3)), shown.max(axis=(1, 3))
    np.testing.assert_array_equal(mixture.alone, np.where(least == most, least, -1))
    assert (np.diff(mixture.pixel) >= 0).all()
    clipped = mixed(np.ones(4, np.float32), mixture, np.float32(0.5))
    np.testing.assert_array_equal(clipped, np.minimum(image, np.float32(0.5)))


def test_a_step_multiplies_a_part_by_its_mean_ratio() -> None:
    triangle = np.array([[0, 0, 1], [1, 0, -1]], np.int32)
    light, part = np.array([1.0, 2.0, 0.0], np.float32), np.array([0, 1], np.int32)
    mixture = mixture_of(at_one_metre(triangle), 1, light, part)
    image = np.array([[2.0, 4.0, 6.0], [2.0, 3.0, 9.0]], np.float32)
    rendered = mixed(np.ones(2, np.float32), mixture, np.float32(np.inf))
    ratio = ratio_of(image, np.maximum(rendered, np.float32(1.0)), np.float32(0.0))
    gain = np.ones(2, np.float32)
    adapt(gain, (1.0, 0.0), mixture, np.ones(image.shape, np.float32), ratio)
    np.testing.assert_allclose(gain, (3.0, 2.0))


@pytest.mark.parametrize("per_px", [1, 2])
def test_a_window_holds_the_target_and_the_sky_beside_it(per_px: int) -> None:
    triangle = np.full((per_px * 60, per_px * 80), -1, np.int32)
    triangle[per_px * 20 : per_px * 30, per_px * 5 : per_px * 41] = 3
    window = window_of(triangle, per_px)
    assert window == (20 - SKY_PX, 0, 10 + 2 * SKY_PX, 41 + SKY_PX)
    light = np.full(5, 2.0, np.float32)
    mixture = mixture_of(at_one_metre(triangle), per_px, light, np.zeros(4, np.int32))
    assert mixture.alone.shape == window[2:]
    assert mixture.pixel.size == 10 * 36
    shade, typical = clipped(mixture, 4.0)
    assert typical == 2.0 * per_px**2
    assert shade.sum() == typical * 10 * 36


def test_an_empty_rendering_has_a_window_without_brightness() -> None:
    nothing = at_one_metre(np.full((60, 80), -1, np.int32))
    mixture = mixture_of(nothing, 1, np.zeros(2, np.float32), np.zeros(1, np.int32))
    shade, typical = clipped(mixture, 4.0)
    assert mixture.pixel.size == 0
    assert typical == 0.0
    assert shade.shape == mixture.window[2:]
    assert not shade.any()


@pytest.mark.parametrize("sky", [0.0, 0.4])
def test_the_misfit_counts_the_sky_beyond_the_window_and_leaves_saturated_pixels_out(sky: float) -> None:
    random = np.random.default_rng(4)
    image = random.random((40, 50)).astype(np.float32)
    triangle = np.full(image.shape, -1, np.int32)
    triangle[18:22, 20:30] = 0
    window = window_of(triangle, 1)
    rendered = random.random(window[2:]).astype(np.float32)
    whole = np.full_like(image, sky)
    row, column, rows, columns = window
    whole[row : row + rows, column : column + columns] = rendered
    saturated = (random.random(image.shape) < 0.1).astype(np.uint8)
    patch = Patch(image, 0.0, 0.0, 0.3, 0.1, 1.0, saturated)
    sigma2 = (0.15 * whole) ** 2 + 0.15**2 + 0.1**2
    each = np.minimum((image - whole) ** 2 / sigma2, 9.0)
    assert squares_of(patch, Behind(rendered, sky), window) == pytest.approx(
        each[saturated == 0].sum(), rel=1e-5
    )


@pytest.mark.parametrize("wall", [0.0, 0.3, 0.6])
def test_a_pose_that_hides_more_of_a_bright_wall_is_not_likelier(wall: float) -> None:
    def at(rows: slice, columns: slice) -> Mixture:
        triangle = np.full((60, 80), -1, np.int32)
        triangle[rows, columns] = 0
        triangle[rows, columns.start : columns.start + 8] = 1  # a part of its own
        return mixture_of(at_one_metre(triangle), 1, np.ones(2, np.float32), np.array([0, 1], np.int32))

    image = np.full((60, 80), wall, np.float32)
    image[20:40, 30:50] = 1.0
    patch = Patch(cv2.GaussianBlur(image, (0, 0), 1.0), 0.0, 0.0, 0.1, 0.02, 1.0)
    right, wider, beside = (
        misfit(patch, at(slice(20, 40), columns), clip=4.0, blur_px=1.0)
        for columns in (slice(30, 50), slice(22, 50), slice(34, 54))
    )
    assert right < 1.0
    assert right < wider
    assert right < beside


def test_what_the_target_leaves_free_of_a_pixel_is_the_share_of_rays_that_meet_nothing() -> None:
    """A pixel in which two faces meet shows nothing of what is behind; it was taken for half free."""
    triangle = np.full((80, 80), -1, np.int32)
    triangle[20:60, 21:41], triangle[20:60, 41:60] = 0, 1
    mixture = mixture_of(at_one_metre(triangle), 2, np.ones(3, np.float32), np.array([0, 1], np.int32))
    row, column = 20 - mixture.window.row, 10 - mixture.window.column
    np.testing.assert_array_equal(mixture.free[row, column - 1 : column + 2], [1.0, 0.5, 0.0])
    assert mixture.alone[row, column + 10] == -1
    assert mixture.free[row, column + 10] == 0.0


def test_a_bright_wall_changes_no_place_within_the_target() -> None:
    triangle = np.full((80, 80), -1, np.int32)
    triangle[20:60, 20:41], triangle[20:60, 41:60] = 0, 1
    mixture = mixture_of(at_one_metre(triangle), 2, np.ones(3, np.float32), np.array([0, 1], np.int32))
    patch = Patch(np.full((40, 40), 0.6, np.float32), 0.0, 0.0, 0.1, 0.02, 1.0)
    behind = brightness_behind(patch, mixture, 1.0)
    assert behind is not None
    inside = behind[20 - mixture.window.row, 15 - mixture.window.column : 25 - mixture.window.column]
    assert inside.max() < 1e-3
    assert behind[0, 0] == pytest.approx(0.6, rel=1e-3)
    assert brightness_behind(patch._replace(image=np.full_like(patch.image, 0.04)), mixture, 1.0) is None
