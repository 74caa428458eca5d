"""Places in the image of the rays of a camera's pixels.

Rays in rows and columns tell the place of an edge along a row or a column to the distance of two rays.
Scattered rays tell it more finely, since each row of rays meets such an edge in another place.
"""

import numpy as np

from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Camera

CYCLE = 4
"""Number of neighbouring pixels after which the places of scattered rays repeat. Numerics: an image that is
smoothed for the search of edges averages over about as many."""


def pixel_samples(camera: Camera, samples: int, *, scattered: bool) -> tuple[FloatArray, FloatArray]:
    """Return columns and rows, px, of ``samples`` x ``samples`` places for each pixel, spread evenly over it.

    Both have the shape (samples * height, samples * width).

    Args:
        camera: the camera.
        samples: number of places of a pixel along rows and columns.
        scattered: whether the places of a pixel, and of its neighbours, differ in both coordinates.
    """
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    column = (np.arange(camera.width)[:, None] + offsets).ravel()
    row = (np.arange(camera.height)[:, None] + offsets).ravel()
    u, v = np.meshgrid(column, row)
    if scattered:
        u -= _displacements(len(row), samples)[:, None]
        v += _displacements(len(column), samples)
    return u, v


def _displacements(lines: int, samples: int) -> FloatArray:
    """Return the displacement of each row or column of places, px, shape (lines,).

    The lines of a pixel are displaced evenly within the distance of two places (N rooks), those of neighbours
    by other parts of what remains, in the order of van der Corput.
    """
    within = (np.arange(lines) % samples + 0.5) / samples - 0.5
    order = np.array((0, 2, 1, 3))[np.arange(lines) // samples % CYCLE]
    displaced: FloatArray = (within + ((order + 0.5) / CYCLE - 0.5) / samples) / samples
    return displaced
