"""Relative motion of two spacecraft in a circular orbit, by the equations of Clohessy and Wiltshire.

The orbital frame is the target's: x outward along the radius, y along the track, z along the orbit's normal.
To first order in the separation over the orbit's radius, the separation d in these turning axes obeys
x'' = 3 n^2 x + 2 n y', y'' = -2 n x', z'' = -n^2 z (W. H. Clohessy, R. S. Wiltshire, Terminal Guidance System
for Satellite Rendezvous, J. Aerospace Sci. 27 (1960) 653-658). They are linear, so that the target's position
as seen from the chaser obeys them too.
"""

from math import cos, sin

import numpy as np

from rpod_schemas.arrays import FloatArray


def transition(rate_rad_s: float, step_s: float) -> FloatArray:
    """Return the transition matrix of (d, d') in the turning axes of the orbital frame, shape (6, 6).

    Args:
        rate_rad_s: rate n of the orbit; 0 for straight motion.
        step_s: time, s.
    """
    n, angle = rate_rad_s, rate_rad_s * step_s
    s, c = sin(angle), cos(angle)
    if abs(angle) < 1e-6:  # the quotients below lose digits that their limits keep
        sine, versine = step_s, 0.5 * n * step_s**2
    else:
        sine, versine = s / n, (1.0 - c) / n
    late = np.zeros((6, 6))
    late[:3, :3] = [[4.0 - 3.0 * c, 0.0, 0.0], [6.0 * (s - angle), 1.0, 0.0], [0.0, 0.0, c]]
    late[:3, 3:] = [
        [sine, 2.0 * versine, 0.0],
        [-2.0 * versine, 4.0 * sine - 3.0 * step_s, 0.0],
        [0.0, 0.0, sine],
    ]
    late[3:, :3] = [[3.0 * n * s, 0.0, 0.0], [6.0 * n * (c - 1.0), 0.0, 0.0], [0.0, 0.0, -n * s]]
    late[3:, 3:] = [[c, 2.0 * s, 0.0], [-2.0 * s, 4.0 * c - 3.0, 0.0], [0.0, 0.0, c]]
    return late


def inertial_transition(rate_rad_s: float, step_s: float, R_chaser_orbit: FloatArray) -> FloatArray:
    """Return the transition matrix of position and velocity relative to inertial space, shape (6, 6).

    Both are in axes that are at rest in inertial space and agree with the chaser's axes at the start.

    Args:
        rate_rad_s: rate of the orbit.
        step_s: time, s.
        R_chaser_orbit: attitude of the orbital frame in the chaser's axes at the start, shape (3, 3).
    """
    spin = np.zeros((3, 3))
    spin[0, 1], spin[1, 0] = -rate_rad_s, rate_rad_s
    into, back = np.eye(6), np.eye(6)
    into[3:, :3], back[3:, :3] = -spin, spin
    angle = rate_rad_s * step_s
    turned = np.array([[cos(angle), -sin(angle), 0.0], [sin(angle), cos(angle), 0.0], [0.0, 0.0, 1.0]])
    before, after = np.zeros((6, 6)), np.zeros((6, 6))
    before[:3, :3] = before[3:, 3:] = R_chaser_orbit.T
    after[:3, :3] = after[3:, 3:] = R_chaser_orbit @ turned
    moved: FloatArray = after @ back @ transition(rate_rad_s, step_s) @ into @ before
    return moved


def straight(step_s: float) -> FloatArray:
    """Return the transition matrix of position and velocity without any acceleration, shape (6, 6)."""
    moved = np.eye(6)
    moved[:3, 3:] = step_s * np.eye(3)
    return moved
