"""Depth points and amplitude edges in one least squares.

The unknowns are those of ``normal_equations``, (dtau, dtheta), and one more: how much too long all ranges of
the frame are. The camera's wiggling is such an error; edges do not feel it, so that where they determine the
range they correct the depth, and where they do not its standard deviation enters the covariance.
"""

import math

import numpy as np
from numba import njit

from rpod_geometry.rays import cast_pose
from rpod_pose.pmd.joint.edge_search import imaged, showing, steepest
from rpod_pose.registration.distance_field import distance_and_gradient
from rpod_pose.registration.field_alignment import AWAY
from rpod_pose.registration.lie_group import in_target, turned

REACH_M, REACH_RAD = 0.5, 0.2
"""Standard deviation of a step that nothing asks for."""
SCALE = 0.2
"""Geman-McClure scale of an edge's place over the reach of its search."""
BLUNTNESS_PX = 1.4
"""Times the noise of its change over the change itself: standard deviation of an edge's place by noise."""
NEAREST_M = 0.3
"""Edges are not weighed for being nearer than this."""


@njit(cache=True, nogil=True)
def add(sums, row, residual, weight):  # type: ignore[no-untyped-def]
    """Add a residual and its derivatives, shape (7,), to information and gradient, shape (7, 8)."""
    for i in range(7):
        scaled = weight * row[i]
        if scaled != 0.0:
            for j in range(i, 7):
                sums[i, j] += scaled * row[j]
            sums[i, 7] += scaled * residual


@njit(cache=True, nogil=True, error_model="numpy")
def depth_sums(points, trust, R, t, bias, field, scale):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Return the sums of depth residuals, the inliers' squares, their number and weight.

    Args:
        points: sensor axes, shape (N, 3), m.
        trust: weight of each point, 0 to 1, shape (N,).
        R: of the target in the sensor, shape (3, 3).
        t: of the target in the sensor, shape (3,), m.
        bias: by which all ranges are too long, m.
        field: ``signed_distance.field_arrays``.
        scale: of Geman and McClure, m.
    """
    origin, spacing, values = field
    per_m, c2 = 1.0 / spacing, scale * scale
    sums, row = np.zeros((7, 8)), np.empty(7)
    squares, inliers, weight_in = 0.0, 0, 0.0
    for n in range(points.shape[0]):
        px, py, pz = points[n, 0], points[n, 1], points[n, 2]
        per_range = 1.0 / np.sqrt(px * px + py * py + pz * pz)
        dx, dy, dz = in_target(R, px * per_range, py * per_range, pz * per_range)
        x, y, z = in_target(R, px - t[0], py - t[1], pz - t[2])
        x, y, z = x - bias * dx, y - bias * dy, z - bias * dz
        d, gx, gy, gz = distance_and_gradient(
            (x - origin[0]) * per_m, (y - origin[1]) * per_m, (z - origin[2]) * per_m, values
        )
        gx, gy, gz = gx * per_m, gy * per_m, gz * per_m
        along = gx * dx + gy * dy + gz * dz
        if along > AWAY:
            continue
        weight = trust[n] * (c2 / (c2 + d * d)) ** 2
        row[0], row[1], row[2] = -gx, -gy, -gz
        row[3], row[4], row[5] = gy * z - gz * y, gz * x - gx * z, gx * y - gy * x
        row[6] = -along
        add(sums, row, d, weight)
        if d * d < c2:
            inliers += 1
            squares += trust[n] * d * d
            weight_in += trust[n]
    return sums, squares, inliers, weight_in


@njit(cache=True, nogil=True, error_model="numpy")
def edge_sums(edges, seen, R, t, lens, image, corner, reach, least, noise):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Return the sums of edge residuals, px, the inliers' squares, px2, and three numbers of samples.

    They are the inliers, those asked, and how many of those that show a change the right pose should have in.

    Args:
        edges: ``EdgeModel.arrays``.
        seen: indices of the samples that show.
        R: of the target in the sensor, shape (3, 3).
        t: of the target in the sensor, shape (3,), m.
        lens: as for ``imaged``.
        image: part of the amplitude image, smoothed, float32.
        corner: column and row of its first pixel.
        reach: of the search, px.
        least: change of amplitude over two pixels that counts.
        noise: standard deviation of an edge's place, px, and of a change of amplitude over two pixels.
    """
    places, directions = edges[0], edges[1]
    sums, row = np.zeros((7, 8)), np.zeros(7)
    squares, inliers, asked, expected = 0.0, 0, 0, 0.0
    c2 = (SCALE * reach) ** 2
    for n in seen:
        x, y, z = places[n, 0], places[n, 1], places[n, 2]
        ax, ay, az = directions[n, 0], directions[n, 1], directions[n, 2]
        px = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0]
        py = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1]
        pz = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2]
        per_z = 1.0 / pz
        sx, sy = px * per_z, py * per_z
        column, line, ux, uy, vx, vy = imaged(sx, sy, lens)
        bx = R[0, 0] * ax + R[0, 1] * ay + R[0, 2] * az
        by = R[1, 0] * ax + R[1, 1] * ay + R[1, 2] * az
        bz = R[2, 0] * ax + R[2, 1] * ay + R[2, 2] * az
        mx, my = (bx - sx * bz) * per_z, (by - sy * bz) * per_z
        tu, tv = ux * mx + uy * my, vx * mx + vy * my
        length = np.sqrt(tu * tu + tv * tv)
        if length < 1e-9:
            continue
        across, down = -tv / length, tu / length
        place, change = steepest(image, column - corner[0], line - corner[1], across, down, reach, least)
        asked += change >= 0.0
        if change <= 0.0:
            continue
        expected += share_within(SCALE * reach, noise[0], BLUNTNESS_PX * noise[1] / change)
        e2 = place * place
        weight = (c2 / (c2 + e2)) ** 2
        gx, gy = across * ux + down * vx, across * uy + down * vy  # by the slopes
        hx, hy, hz = gx * per_z, gy * per_z, -(gx * sx + gy * sy) * per_z
        kx, ky, kz = in_target(R, hx, hy, hz)
        row[0], row[1], row[2] = kx, ky, kz
        row[3], row[4], row[5] = y * kz - z * ky, z * kx - x * kz, x * ky - y * kx
        add(sums, row, -place, weight)
        if e2 < c2:
            inliers += 1
            squares += e2
    return sums, squares, inliers, asked, expected


@njit(cache=True, nogil=True, error_model="numpy")
def share_within(reach, sharp, noisy):  # type: ignore[no-untyped-def]
    """Return the share of normal errors within a reach, whose variance is the sum of two squares."""
    return math.erf(reach / math.sqrt(2.0 * (sharp * sharp + noisy * noisy)))


@njit(cache=True, nogil=True, error_model="numpy")
def align(points, trust, R, t, model, image, camera, schedule, depth_errors, edge_errors, buffers):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Return R, t, information (7, 7), points matched, their squares, edges found, asked, expected, and bias.

    Args:
        points: sensor axes, shape (N, 3), m.
        trust: weight of each point, shape (N,).
        R: of the target in the sensor, shape (3, 3).
        t: of the target in the sensor, shape (3,), m.
        model: triangles, ``field_arrays``, ``EdgeModel.arrays``.
        image: part of the amplitude image, its first pixel, change that counts, noise of a change.
        camera: coarse ``RayGrid.arrays``, (stride, offset), lens as for ``imaged``.
        schedule: scale, m, and reach, px, of each step, shape (steps, 2).
        depth_errors: noise, m, effective points, sigmas, m, of the bias, of what differs from it, and of
            the model's own error.
        edge_errors: noise, px, effective samples.
        buffers: ranges and triangles of the coarse pixels.
    """
    triangles, field, edges = model
    patch, corner, least, noise_change = image
    grid, coarse, lens = camera
    noise, most_points, bias_sigma, uneven, slack = depth_errors
    noise_px, most_edges = edge_errors
    range_m, owner = buffers
    bias, held = 0.0, np.zeros(7)
    held[:3], held[3:6] = 1.0 / REACH_M**2, 1.0 / REACH_RAD**2
    steps = schedule.shape[0]
    seen = np.empty(0, np.int64)
    total = np.zeros((7, 8))
    inliers, squares, found, squares_px, asked, expected = 0, 0.0, 0, 0.0, 0, 0.0
    for step in range(steps):
        if step == 0 or step == steps - 2:
            cast_pose(grid, triangles, R, t, True, range_m, owner)
            seen = showing(edges, R, t, lens, coarse, range_m)
        scale, reach = schedule[step]
        total = np.zeros((7, 8))
        sums, squares, inliers, weight = depth_sums(points, trust, R, t, bias, field, scale)
        if inliers > 0:
            variance = max(squares / weight, noise * noise) / min(most_points, weight)
            total += sums / (weight * (variance + uneven * uneven + slack * slack))
        sums, squares_px, found, asked, expected = edge_sums(
            edges, seen, R, t, lens, patch, corner, reach, least, (noise_px, noise_change)
        )
        if found > 0:
            per_m = lens[0] / max(t[2], NEAREST_M)
            variance = max(squares_px / found, noise_px * noise_px) / min(most_edges, found)
            widened = (reach / schedule[steps - 1, 1]) ** 4
            total += sums / (found * widened * (variance + (slack * per_m) ** 2))
        total[6, 6] += 1.0 / (bias_sigma * bias_sigma)
        total[6, 7] += bias / (bias_sigma * bias_sigma)
        for i in range(7):
            for j in range(i):
                total[i, j] = total[j, i]
        delta = np.linalg.solve(total[:, :7] + np.diag(held), -total[:, 7])
        t = t + R @ delta[:3]
        R = turned(R, delta[3:6])
        bias += delta[6]
    return R, t, total[:, :7].copy(), inliers, squares, found, asked, expected, bias


@njit(cache=True, nogil=True, error_model="numpy")
def agreement(measured, sigma, grid, triangles, R, t, tolerance, missing, buffers):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Return the weight of the coarse pixels that agree with a pose, and that of all that say "surface".

    Args:
        measured: range, shape (rows, columns), m, NaN for none.
        sigma: standard deviation of its noise, m, same shape.
        grid: coarse ``RayGrid.arrays``.
        triangles: of the target, shape (T, 3, 3).
        R: of the target in the sensor, shape (3, 3).
        t: of the target in the sensor, shape (3,), m.
        tolerance: within which ranges agree, m; twice their noise where that is more.
        missing: weight of a predicted pixel without a measurement.
        buffers: ranges and triangles of the coarse pixels.
    """
    range_m, owner = buffers
    cast_pose(grid, triangles, R, t, True, range_m, owner)
    agreeing, asked = 0.0, 0.0
    for i in range(range_m.shape[0]):
        for j in range(range_m.shape[1]):
            m = measured[i, j]
            if np.isnan(m):
                asked += missing if owner[i, j] >= 0 else 0.0
                continue
            asked += 1.0
            if owner[i, j] >= 0 and abs(m - range_m[i, j]) < max(tolerance, 2.0 * sigma[i, j]):
                agreeing += 1.0
    return agreeing, asked


@njit(cache=True, nogil=True, error_model="numpy")
def in_place(edges, R, t, lens, coarse, range_m, image, reach, sigma):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Return the samples of edges that are where a pose has them, those that should be, and those asked.

    Args:
        edges: ``EdgeModel.arrays``.
        R: of the target in the sensor, shape (3, 3).
        t: of the target in the sensor, shape (3,), m.
        lens: as for ``imaged``.
        coarse: stride and offset of the rendered pixels.
        range_m: what is rendered at the pose, shape (rows, columns).
        image: part of the amplitude image, its first pixel, change that counts, noise of a change.
        reach: of the search, px.
        sigma: standard deviation of an edge's place, px.
    """
    patch, corner, least, noise = image
    seen = showing(edges, R, t, lens, coarse, range_m)
    found = edge_sums(edges, seen, R, t, lens, patch, corner, reach, least, (sigma, noise))
    return found[2], found[4], found[3]
