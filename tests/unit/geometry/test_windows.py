import numpy as np
import pytest

from rpod_geometry.windows import window_around


@pytest.mark.parametrize(
    ("rays", "window"),
    [
        ([(2, 4), (3, 6)], (slice(1, 5), slice(2, 9))),
        ([(0, 1)], (slice(0, 2), slice(0, 4))),
        ([], (slice(None), slice(None))),
    ],
    ids=["with a margin", "at the border", "no rays"],
)
def test_a_window_holds_the_rays_and_those_around_them(rays, window):
    image = np.zeros((6, 10), bool)
    for place in rays:
        image[place] = True
    assert window_around(image, (1, 2)) == window
