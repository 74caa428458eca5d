"""Drawing the target onto a scan: steps in the distance field from afar, steps to the faces to finish.

From afar each return is drawn along the distance field's gradient, which needs no correspondence. To finish,
the target is cast at the pose: each return belongs to the face that its own ray meets, and its residual is
the distance from that face's plane, weighted for an error along the ray (projective point to plane, after
G. Blais, M. D. Levine, Registering Multiview Range Data to Create 3D Computer Objects, IEEE PAMI 17, 1995).
Both steps share the unknowns of ``normal_equations``; outliers fade by Geman-McClure weights.
"""

import numpy as np
from numba import njit

from rpod_geometry.rays import cast_pose
from rpod_pose.registration.distance_field import distance_and_gradient
from rpod_pose.registration.field_alignment import add_upper, held, mirror
from rpod_pose.registration.lie_group import in_target, turned

FEWEST = 3
"""Fewer returns on faces determine no step."""
ALONE = 0.75
"""Leverage beyond which a return alone determines a motion: it may be on the wrong face."""


@njit(cache=True, nogil=True)
def spread(information, R):  # type: ignore[no-untyped-def]
    """Return the covariance of (dp, dtheta) in the sensor's axes from information about (dtau, dtheta)."""
    to_sensor = np.zeros((6, 6))
    to_sensor[:3, :3] = R
    to_sensor[3:, 3:] = R
    return to_sensor @ np.linalg.inv(information) @ to_sensor.T


@njit(cache=True, nogil=True, error_model="numpy")
def shared(information, claims):  # type: ignore[no-untyped-def]
    """Return the information without that of returns whose leverage is beyond ``ALONE``.

    Args:
        information: of all returns, shape (6, 6).
        claims: gradient and weight of each return, shape (N, 7).
    """
    leverages = np.linalg.inv(information + 1e-3 * np.eye(6))
    for i in range(6):
        leverages[i, :i] = 0.0
        leverages[i, i + 1 :] *= 2.0
    kept = information.copy()
    for claim in claims:
        leverage = 0.0
        for i in range(6):
            row = 0.0
            for j in range(i, 6):
                row += leverages[i, j] * claim[j]
            leverage += claim[i] * row
        if claim[6] * leverage > ALONE:
            for i in range(6):
                for j in range(6):
                    kept[i, j] -= claim[6] * claim[i] * claim[j]
    return kept


@njit(cache=True, nogil=True, error_model="numpy")
def settle(points, rays, R, t, grid, faces, field, noise, scales, range_m, owner):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Return R, t, information, squares and inliers after one step to the faces for each scale, m.

    Args:
        points: returns, sensor axes, shape (N, 3), m.
        rays: row-major index of each return's ray, -1 for none, shape (N,).
        R: of the target in the sensor, shape (3, 3).
        t: of the target in the sensor, shape (3,), m.
        grid: ``RayGrid.arrays``.
        faces: ``SurfaceModel.faces``.
        field: ``SurfaceModel.coarse_field``, for returns whose rays pass the target by.
        noise: sigma of a range and slack of a plane, m; squared cosine of incidence below which the distance
            from a plane, not along the ray, tells outliers; and one over the standard deviation of the
            field's distance of a return beyond the outline, 1/m, 0 to leave those out.
        scales: Geman-McClure scales of a range's residual, shape (steps,), m.
        range_m: buffer, shape (rows, columns).
        owner: buffer, shape (rows, columns).

    The information is what the faces tell in the last step, in units of one over its weights' sigmas, of
    what more than one return tells; inliers count in it as whole ones, though good ones fade a little too.
    The squares, m2, and the number of inliers are those within the last scale.
    """
    triangles, normals, offsets, _ = faces
    origin, spacing, values = field
    sigma, slack, steepest, per_outline_m = noise
    per_m = 1.0 / spacing
    flat = owner.reshape(-1)
    information, squares, inliers, counted = np.zeros((6, 6)), 0.0, 0, 0.0
    claims = np.empty((points.shape[0], 7))
    for scale in scales:
        cast_pose(grid, triangles, R, t, True, range_m, owner)
        information, outline, gradient = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros(6)
        squares, inliers, counted, c2 = 0.0, 0, 0.0, scale * scale
        claims[:, 6] = 0.0
        for n in range(points.shape[0]):
            px, py, pz = points[n, 0], points[n, 1], points[n, 2]
            x, y, z = in_target(R, px - t[0], py - t[1], pz - t[2])
            face = flat[rays[n]] if rays[n] >= 0 else -1
            if face < 0:  # beyond the outline, which is drawn to it
                d, gx, gy, gz = distance_and_gradient(
                    (x - origin[0]) * per_m, (y - origin[1]) * per_m, (z - origin[2]) * per_m, values
                )
                weight = (c2 / (c2 + d * d)) ** 2 * per_outline_m * per_outline_m
                add_upper(outline, gradient, (gx * per_m, gy * per_m, gz * per_m), (x, y, z), d, weight)
                continue
            dx, dy, dz = in_target(R, px, py, pz)
            n0, n1, n2 = normals[face, 0], normals[face, 1], normals[face, 2]
            e = n0 * x + n1 * y + n2 * z - offsets[face]
            cosine2 = (n0 * dx + n1 * dy + n2 * dz) ** 2 / (px * px + py * py + pz * pz)
            along2 = e * e / max(cosine2, steepest, 1e-6)
            fading = (c2 / (c2 + along2)) ** 2
            weight = fading / (sigma * sigma * cosine2 + slack * slack)
            add_upper(information, gradient, (n0, n1, n2), (x, y, z), e, weight)
            claims[n] = (n0, n1, n2, y * n2 - z * n1, z * n0 - x * n2, x * n1 - y * n0, weight)
            if along2 < c2:
                inliers += 1
                counted += fading
                squares += e * e
        mirror(information)
        mirror(outline)
        if inliers < FEWEST:
            break
        step = held(information + outline, gradient, 1.0)
        t = t + R @ step[:3]
        R = turned(R, step[3:])
    return R, t, shared(information, claims) * (inliers / max(counted, 1e-6)), squares, inliers
