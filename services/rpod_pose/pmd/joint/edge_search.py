"""The model's edges in an amplitude image: which show, where each lies, and what that says of the pose.

An edge sample shows where one of its faces is seen and nothing stands before it. From its projection the
image is searched along the projected edge's normal for the steepest change of amplitude, nearer ones
preferred, to sub-pixels by a parabola. How far that is from the projection is the residual (after
T. Drummond, R. Cipolla, Real-Time Visual Tracking of Complex Structures, IEEE PAMI 24(7), 2002).
"""

import numpy as np
from numba import njit

from rpod_pose.registration.lie_group import in_target

NEAR_M = 0.05
HIDDEN_SHARE = 0.02
"""An edge is hidden where it lies farther behind what is rendered around it than this share of its range."""
MOST_REACH = 32
"""Pixels: the longest profile both ways."""
FLAT = 0.02
"""Of the change that counts: noise alone changes more, so that less is a glint's or a blackout's."""
MIDDLE = 2
"""Pixels both ways of a line's middle."""


@njit(cache=True, nogil=True, error_model="numpy")
def imaged(x, y, lens):  # type: ignore[no-untyped-def]
    """Return column, row and their derivatives by the slopes x and y; lens is fx, fy, cx, cy, k1 ... k3."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = lens
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    growth = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
    column = fx * (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)) + cx
    row = fy * (y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y) + cy
    across = growth * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    xx = radial + growth * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    yy = radial + growth * y * y + 6.0 * p1 * y + 2.0 * p2 * x
    return column, row, fx * xx, fx * across, fy * across, fy * yy


@njit(cache=True, nogil=True, error_model="numpy")
def showing(edges, R, t, lens, coarse, range_m):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Return the indices of the samples that show at a pose.

    Args:
        edges: ``EdgeModel.arrays``.
        R: of the target in the sensor, shape (3, 3).
        t: of the target in the sensor, shape (3,), m.
        lens: as for ``imaged``.
        coarse: stride and offset of the rendered pixels.
        range_m: what is rendered at the pose, shape (rows, columns), inf where nothing is.
    """
    places, _, normals = edges
    stride, offset = coarse
    rows, columns = range_m.shape
    found, count = np.empty(len(places), np.int64), 0
    sx, sy, sz = in_target(R, -t[0], -t[1], -t[2])  # the sensor, target axes
    for n in range(len(places)):
        x, y, z = places[n, 0], places[n, 1], places[n, 2]
        vx, vy, vz = sx - x, sy - y, sz - z
        one = normals[n, 0, 0] * vx + normals[n, 0, 1] * vy + normals[n, 0, 2] * vz > 0.0
        other = normals[n, 1, 0] * vx + normals[n, 1, 1] * vy + normals[n, 1, 2] * vz > 0.0
        if not (one or other):
            continue
        px = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0]
        py = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1]
        pz = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2]
        if pz < NEAR_M:
            continue
        projected = imaged(px / pz, py / pz, lens)
        column, row = projected[0], projected[1]
        i, j = int((row - offset) // stride), int((column - offset) // stride)
        if not (0 <= i < rows - 1 and 0 <= j < columns - 1):
            continue
        before = max(range_m[i, j], range_m[i + 1, j], range_m[i, j + 1], range_m[i + 1, j + 1])
        distance = np.sqrt(px * px + py * py + pz * pz)
        if distance <= (1.0 + HIDDEN_SHARE) * before:
            found[count] = n
            count += 1
    return found[:count]


@njit(cache=True, nogil=True, error_model="numpy")
def steepest(image, column, row, across, down, reach, least):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Return where along a line the image changes most, px from its middle, and by how much over two pixels.

    The change is 0 where none exceeds ``least``, and negative where there was nothing to look at: the line
    leaves the image, is dark in its middle, or is clipped all along.

    Args:
        image: float32, shape (rows, columns).
        column: middle of the line.
        row: middle of the line.
        across: of the line's unit vector.
        down: of the line's unit vector.
        reach: pixels searched both ways.
        least: change that counts.
    """
    most = min(int(reach), MOST_REACH) + 2
    rows, columns = image.shape
    far_column, far_row = most * abs(across) + 1.0, most * abs(down) + 1.0
    inside = far_column <= column < columns - 1.0 - far_column and far_row <= row < rows - 1.0 - far_row
    profile = np.empty(2 * MOST_REACH + 5)
    if not inside:
        return 0.0, -1.0
    lowest, highest, brightest = np.inf, -np.inf, 0.0
    for k in range(-most, most + 1):
        u, v = column + k * across, row + k * down
        j, i = int(u), int(v)
        a, b = u - j, v - i
        upper = image[i, j] + a * (image[i, j + 1] - image[i, j])
        lower = image[i + 1, j] + a * (image[i + 1, j + 1] - image[i + 1, j])
        profile[k + most] = upper + b * (lower - upper)
        lowest, highest = min(lowest, profile[k + most]), max(highest, profile[k + most])
        if abs(k) <= MIDDLE:
            brightest = max(brightest, profile[k + most])
    if highest - lowest < FLAT * least or brightest < FLAT * least:
        return 0.0, -1.0
    best, place, change = 0.0, 0, 0.0
    width = 0.5 * reach + 1.0
    for k in range(2, 2 * most - 1):
        here = abs(profile[k + 1] - profile[k - 1])
        score = here / (1.0 + ((k - most) / width) ** 2)
        peak = here >= abs(profile[k] - profile[k - 2]) and here >= abs(profile[k + 2] - profile[k])
        if here >= least and score > best and peak:
            best, place, change = score, k, here
    if best == 0.0:
        return 0.0, 0.0
    before, after = abs(profile[place] - profile[place - 2]), abs(profile[place + 2] - profile[place])
    bend = before - 2.0 * change + after
    shift = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return place - most + shift, change
