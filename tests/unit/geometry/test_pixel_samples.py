"""Places of the rays of a camera's pixels."""

import numpy as np
import pytest
from tests.pmd_frames import CAMERA

from rpod_geometry.pixel_samples import CYCLE, pixel_samples


@pytest.mark.parametrize("samples", [1, 2, 3])
def test_scattered_places_are_in_their_pixels_and_tell_an_edge_more_finely(samples: int) -> None:
    plain, scattered = (np.array(pixel_samples(CAMERA, samples, scattered=each)) for each in (False, True))
    lines = np.arange(plain.shape[2]) // samples, np.arange(plain.shape[1])[:, None] // samples
    beside = scattered - np.broadcast_arrays(*lines)
    assert np.abs(beside).max() < 0.5
    assert np.abs((scattered - plain)[:, : CYCLE * samples, : CYCLE * samples].mean(axis=(1, 2))).max() < 1e-9
    of_edges = (
        np.unique(beside[0, : CYCLE * samples, :samples].round(6)),
        np.unique(beside[1, :samples, : CYCLE * samples].round(6)),
    )
    assert [len(each) for each in of_edges] == [CYCLE * samples**2] * 2
