import numpy as np
import pytest
from pmd_frames import CAMERA, frame_of

from rpod_pose.pmd.paper_2018.edge_image import EdgeImage, Edges, bent, edge_image, straightened
from rpod_schemas.config.pmd.amplitude import EdgeImageConfig

CONFIG = EdgeImageConfig()
CORNER = (120.3, 80.6)


def square(level, *, dtype=np.float32, side=90.0, camera=CAMERA):
    """Return a frame of a bright square with its corner off the pixels' centres: edge pixels are mixed."""
    column, row = np.arange(CAMERA.width), np.arange(CAMERA.height)

    def covered(at, start):
        return np.clip(np.minimum(at + 0.5, start + side) - np.maximum(at - 0.5, start), 0.0, 1.0)

    light = level * covered(row, CORNER[1])[:, None] * covered(column, CORNER[0])
    return frame_of(4.0, amplitude=light.astype(dtype), camera=camera)


def edges(frame) -> Edges:
    image = edge_image(frame, CONFIG)
    assert isinstance(image, EdgeImage)
    return image.inner


@pytest.mark.parametrize(
    ("level", "dtype"), [(255.0, np.uint8), (3000.0, np.uint16), (0.4, np.float32), (4e6, np.float32)]
)
def test_an_edge_is_found_to_sub_pixel_whatever_the_scale_of_the_amplitude(level, dtype):
    image = edges(square(level, dtype=dtype))
    left = image.places[np.abs(image.places[:, 0] - CORNER[0]) < 3.0]
    inner = left[(left[:, 1] > CORNER[1] + 5.0) & (left[:, 1] < CORNER[1] + 80.0)]
    assert np.abs(inner[:, 0] - CORNER[0]).max() < 0.12


def test_an_image_may_be_full_of_edges():
    stripes = np.where(np.arange(CAMERA.width) % 5 < 2, 400.0, 20.0)
    image = edges(frame_of(4.0, amplitude=np.tile(stripes, (CAMERA.height, 1)).astype(np.float32)))
    assert len(image.places) > np.iinfo(np.int16).max
    assert np.isfinite(image.places).all()


def test_a_glint_leaves_the_edges_of_the_rest():
    light = square(400.0).amplitude.copy()
    light[100:140, 140:180] = 6_000.0
    left = edges(frame_of(4.0, amplitude=light)).places
    assert (np.abs(left[:, 0] - CORNER[0]) < 0.3).sum() > 60


def test_a_pattern_on_the_surface_is_no_silhouette():
    light = square(400.0).amplitude.copy()
    light[100:140, 140:180] = 200.0
    image = edge_image(frame_of(4.0, amplitude=light), CONFIG)
    assert isinstance(image, EdgeImage)
    within = np.all((image.outer.places > 130.0) & (image.outer.places < 164.0), axis=1)
    assert not within.any()
    assert len(image.inner.places) > len(image.outer.places) > 200
    assert image.edges(silhouette=True) is image.outer
    assert image.edges(silhouette=False) is image.inner


def test_every_side_has_a_line():
    lengths = np.linalg.norm(np.diff(edges(square(500.0)).segments, axis=1)[:, 0], axis=1)
    assert (lengths > 70.0).sum() >= 4


def test_places_and_lines_are_straightened():
    lens = CAMERA.model_copy(update={"distortion": np.array([-1.0, 0.1, 0.002, -0.001, 0.0])})
    seen, straight = edges(square(500.0)), edges(square(500.0, camera=lens))
    assert np.allclose(bent(straight.places, lens), seen.places, atol=1e-6)
    assert np.allclose(straightened(seen.places, lens), straight.places, atol=1e-6)
    assert np.abs(straight.segments - seen.segments).max() > 0.5


@pytest.mark.parametrize(
    ("amplitude", "reason"),
    [
        (None, "no amplitude image"),
        (np.zeros((1, 1), np.uint16), "0 lit pixels"),
        (np.full((1, 1), np.nan, np.float32), "0 lit pixels"),
        (np.full((1, 1), np.inf, np.float32), "0 lit pixels"),
        (np.full((1, 1), -1.0, np.float32), "0 lit pixels"),
        (np.full((1, 1), 900, np.uint16), "no straight line"),
    ],
)
def test_an_image_without_edges_is_a_reason(amplitude, reason):
    assert reason in edge_image(frame_of(4.0, amplitude=amplitude), CONFIG)


def test_a_lens_that_folds_the_image_is_a_reason():
    folded = CAMERA.model_copy(update={"distortion": np.array([-90.0, 0.0, 0.0, 0.0, 0.0])})
    assert "no inverse" in edge_image(square(500.0, camera=folded), CONFIG)
