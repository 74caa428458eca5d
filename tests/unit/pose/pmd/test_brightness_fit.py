"""Parts that the pixels of a rendering show, and the brightness that is fitted to them."""

from collections.abc import Sequence

import cv2
import numpy as np
import pytest

from rpod_geometry.finer_rays import SAMPLES, Surface
from rpod_geometry.rays import GridArrays, RayGrid, RenderBuffers, cast_pose
from rpod_pose.pmd.joint.brightness.brightness_fit import (
    Behind,
    adapt,
    clipped,
    misfit,
    mixed,
    ratio_of,
    squares_of,
)
from rpod_pose.pmd.joint.brightness.mixture import Mixture, Shape, mixture_of
from rpod_pose.pmd.joint.brightness.patch_renderer import brightness_behind
from rpod_pose.pmd.joint.edge_search import Patch
from rpod_pose.pmd.rendering import SKY_PX, Window, window_of
from rpod_schemas.types import Camera
from rpod_target.mesh.topology import beyond_sides

ROWS, COLUMNS = 60, 80
CAMERA = Camera(width=COLUMNS, height=ROWS, fx=1e4, fy=1e4, cx=0.0, cy=0.0)
"""So long a focal length that all rays have nearly the same length."""
Span = tuple[float, float]


def rendered(triangles_m: np.ndarray, per_px: int) -> tuple[GridArrays, RenderBuffers]:
    """Return the rays of the camera, and what they meet of triangles in sensor axes."""
    rays = RayGrid.pinhole(CAMERA, per_px).in_single_precision().arrays
    range_m = np.empty(rays.components.shape[1:], np.float32)
    hits = RenderBuffers(range_m, np.empty(range_m.shape, np.int32))
    cast_pose(rays, triangles_m, np.eye(3), np.zeros(3), True, *hits)
    return rays, hits


def mixture(
    *spans: tuple[Span, Span],
    per_px: int = 1,
    light: float = 1.0,
    behind_m: float = 0.0,
    rad_per_m: Sequence[float] = (),
) -> Mixture:
    """Return what pixels show of rectangles at 1 m, each a part, by first and last + 1 of its lines.

    Each is ``behind_m`` farther away than the one before it.
    """
    triangles_m = []
    for rows, columns in spans:
        (top, bottom), (left, right) = ((np.array(span) - 0.5) / CAMERA.fx for span in (rows, columns))
        a, b, c, d = (left, top, 1.0), (left, bottom, 1.0), (right, bottom, 1.0), (right, top, 1.0)
        z_m = 1.0 + behind_m * len(triangles_m) / 2
        triangles_m += [z_m * np.array((a, b, c)), z_m * np.array((a, c, d))]
    corners_m = np.array(triangles_m).reshape(-1, 3, 3)
    if not len(corners_m):  # nothing in view: behind the camera
        corners_m = -np.ones((1, 3, 3))
    part = np.arange(len(corners_m), dtype=np.int32) // 2
    rays, hits = rendered(corners_m, per_px)
    surface = Surface(corners_m, beyond_sides(corners_m), np.eye(3), np.zeros(3))
    shape = Shape(surface, part, np.full(len(corners_m), light, np.float32), np.array(rad_per_m))
    return mixture_of(rays.components, hits, per_px, shape)


@pytest.mark.parametrize("per_px", [1, 2, 3])
def test_a_pixel_shows_of_each_part_as_much_as_it_covers(per_px: int) -> None:
    left, middle, right = 20.3, 40.6, 55.9
    seen = mixture(((20, 30), (left, middle)), ((20, 30), (middle, right)), per_px=per_px, light=2.0)
    image = mixed(np.array([1.0, 3.0], np.float32), seen, np.float32(np.inf))
    row = image[25 - seen.window.row]
    columns = seen.window.column + np.arange(len(row)) - 0.5
    covered = [
        np.clip(np.minimum(columns + 1, b) - np.maximum(columns, a), 0.0, 1.0)
        for a, b in ((left - 0.5, middle - 0.5), (middle - 0.5, right - 0.5))
    ]
    expected = 2.0 * covered[0] + 6.0 * covered[1]
    np.testing.assert_allclose(row, expected, atol=6.0 / SAMPLES**2 / 1.5)
    np.testing.assert_allclose(
        seen.free[25 - seen.window.row], 1.0 - covered[0] - covered[1], atol=1.0 / SAMPLES**2 / 1.5
    )
    assert (np.diff(seen.pixel) >= 0).all()
    whole = mixed(np.ones(2, np.float32), seen, np.float32(0.5))
    assert whole.max() == 0.5


def test_a_pixel_adds_the_phasors_of_its_parts() -> None:
    """Two parts of half a pixel each, with opposite phases, show nothing; with another frequency half."""
    spans = ((20, 30), (20, 40.5)), ((20, 30), (40.5, 60))
    light, behind_m = 1.0, 0.01
    shown = []
    for rad_per_m in ((), (np.pi / behind_m,), (np.pi / behind_m, 2.0 * np.pi / behind_m)):
        seen = mixture(*spans, light=light, behind_m=behind_m, rad_per_m=rad_per_m)
        image = mixed(np.ones(2, np.float32), seen, np.float32(np.inf))
        shown.append(image[25 - seen.window.row, 40 - seen.window.column])
        np.testing.assert_allclose(image[25 - seen.window.row, 38 - seen.window.column], 1.0, rtol=1e-3)
    np.testing.assert_allclose(shown, (0.985, 0.015, 0.5), atol=0.01)


def test_a_step_multiplies_a_part_by_its_mean_ratio() -> None:
    alone = np.array([[0, 0, 1], [1, 0, -1]], np.int32)
    shown = np.flatnonzero(alone.ravel() >= 0).astype(np.int32)
    part = alone.ravel()[shown]
    seen = Mixture(Window(0, 0, 2, 3), shown, part, (part + 1.0).astype(np.float32), alone, alone < 0)
    image = np.array([[2.0, 4.0, 6.0], [2.0, 3.0, 9.0]], np.float32)
    shade = mixed(np.ones(2, np.float32), seen, np.float32(np.inf))
    ratio = ratio_of(image, np.maximum(shade, np.float32(1.0)), np.float32(0.0), np.float32(np.inf))
    gain = np.ones(2, np.float32)
    adapt(gain, (1.0, 0.0), seen, np.ones(image.shape, np.float32), ratio)
    np.testing.assert_allclose(gain, (3.0, 2.0))


@pytest.mark.parametrize("per_px", [1, 2])
def test_a_window_holds_the_target_and_the_sky_beside_it(per_px: int) -> None:
    triangle = np.full((per_px * ROWS, per_px * COLUMNS), -1, np.int32)
    triangle[per_px * 20 : per_px * 30, per_px * 5 : per_px * 41] = 3
    window = window_of(triangle, per_px)
    assert window == (20 - SKY_PX, 0, 10 + 2 * SKY_PX, 41 + SKY_PX)
    seen = mixture(((20, 30), (5, 41)), per_px=per_px, light=2.0)
    assert seen.alone.shape == window[2:]
    assert seen.pixel.size == 10 * 36
    shade, typical = clipped(seen, 4.0)
    assert typical == pytest.approx(2.0, rel=1e-3)
    assert shade.sum() == pytest.approx(typical * 10 * 36, rel=1e-3)


def test_an_empty_rendering_has_a_window_without_brightness() -> None:
    seen = mixture()
    shade, typical = clipped(seen, 4.0)
    assert seen.pixel.size == 0
    assert typical == 0.0
    assert shade.shape == seen.window[2:]
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
    patch = Patch(image, image, 0.0, 0.0, 0.3, 0.1, 1.0, saturated)
    sigma2 = (0.15 * whole) ** 2 + 0.15**2 + 0.1**2
    each = np.minimum((image - whole) ** 2 / sigma2, 9.0)
    assert squares_of(patch, Behind(rendered, sky), window) == pytest.approx(
        each[saturated == 0].sum(), rel=1e-5
    )


@pytest.mark.parametrize("wall", [0.0, 0.3, 0.6])
def test_a_pose_that_hides_more_of_a_bright_wall_is_not_likelier(wall: float) -> None:
    def at(rows: slice, columns: slice) -> Mixture:
        lines = rows.start, rows.stop
        middle = columns.start + 8  # the first eight columns are a part of their own
        return mixture((lines, (columns.start, middle)), (lines, (middle, columns.stop)))

    image = np.full((60, 80), wall, np.float32)
    image[20:40, 30:50] = 1.0
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0)
    patch = Patch(smooth, smooth, 0.0, 0.0, 0.1, 0.02, 1.0)
    right, wider, beside = (
        misfit(patch, at(slice(20, 40), columns), clip=4.0, blur_px=1.0)
        for columns in (slice(30, 50), slice(22, 50), slice(34, 54))
    )
    assert right < 1.0
    assert right < wider
    assert right < beside


def test_what_the_target_leaves_free_of_a_pixel_is_the_share_of_rays_that_meet_nothing() -> None:
    """A pixel in which two faces meet shows nothing of what is behind; it was taken for half free."""
    seen = mixture(((10, 30), (10.5, 20.5)), ((10, 30), (20.5, 30)), per_px=2)
    row, column = 15 - seen.window.row, 10 - seen.window.column
    np.testing.assert_array_equal(seen.free[row, column - 1 : column + 2], [1.0, 0.5, 0.0])
    assert seen.alone[row, column + 10] == -1
    assert seen.free[row, column + 10] == 0.0


def test_a_bright_wall_changes_no_place_within_the_target() -> None:
    seen = mixture(((10, 30), (10, 20.5)), ((10, 30), (20.5, 30)), per_px=2)
    image = np.full((40, 40), 0.6, np.float32)
    patch = Patch(image, image, 0.0, 0.0, 0.1, 0.02, 1.0)
    behind = brightness_behind(patch, seen, 1.0)
    assert behind is not None
    inside = behind[20 - seen.window.row, 15 - seen.window.column : 25 - seen.window.column]
    assert inside.max() < 1e-3
    assert behind[0, 0] == pytest.approx(0.6, rel=1e-3)
    assert brightness_behind(patch._replace(image=np.full_like(patch.image, 0.04)), seen, 1.0) is None
