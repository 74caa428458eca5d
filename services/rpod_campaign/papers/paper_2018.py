"""Values that the 2018 paper prints: all values of its tables, and statements of its prose on them.

Source: K. Klionovska, J. Ventura, H. Benninghoff, F. Huber, Close Range Tracking of an Uncooperative Target
in a Sequence of Photonic Mixer Device (PMD) Images, Robotics 7(1), 2018, 5. The values are from its text
without the figures: a value that only a figure shows is missing here, and its place stays blank.
"""

from typing import NamedTuple

CITATION = "Klionovska et al., Robotics 7(1), 2018"
OBLIQUE, TUMBLING = "oblique", "tumbling"
"""Scenarios of section 4: a stabilised target, approached at an angle; one turning at 5 deg/s, approached
frontally."""
ICP, EPNP = "icp-reverse-calibration", "epnp"
IMAGES = 20
"""Number of images of each set (section 4)."""
RADII_PX = (10, 15, 20, 25, 30, 35, 40, 45, 50)
"""Radii of the neighbour search, px (Table 2)."""
RADIUS_PX = 25
"""Radius of Figs. 10 to 12 and Tables 3 and 4, px."""
SEVENTH = 7
"""Number of the image in Figs. 13 and 14, counted from one."""


class Rms(NamedTuple):
    """A column of Table 2. The axes are not stated: t^B suggests the target's, the values the camera's."""

    roll_deg: float
    pitch_deg: float
    yaw_deg: float
    x_m: float
    y_m: float
    z_m: float
    cpu_s: float
    """Average time for one image, s."""


RMS = {
    (OBLIQUE, 10): Rms(4.050, 5.822, 2.232, 0.077, 0.375, 0.157, 2.1),
    (OBLIQUE, 15): Rms(3.102, 1.463, 2.024, 0.106, 0.056, 0.182, 2.3),
    (OBLIQUE, 20): Rms(3.08, 4.71, 2.58, 0.08, 0.04, 0.11, 2.5),
    (OBLIQUE, 25): Rms(2.59, 3.96, 2.308, 0.088, 0.045, 0.096, 2.6),
    (OBLIQUE, 30): Rms(2.38, 3.744, 2.44, 0.086, 0.045, 0.100, 2.9),
    (OBLIQUE, 35): Rms(2.58, 3.081, 1.044, 0.06, 0.04, 0.08, 3.0),
    (OBLIQUE, 40): Rms(2.69, 5.134, 2.02, 0.074, 0.047, 0.117, 3.1),
    (OBLIQUE, 45): Rms(2.82, 2.91, 2.36, 0.058, 0.031, 0.087, 3.3),
    (OBLIQUE, 50): Rms(2.51, 3.52, 2.10, 0.077, 0.038, 0.088, 3.5),
    (TUMBLING, 10): Rms(3.068, 5.29, 1.94, 0.099, 0.089, 0.05, 3.1),
    (TUMBLING, 15): Rms(6.84, 5.94, 1.83, 0.16, 0.109, 0.046, 3.45),
    (TUMBLING, 20): Rms(8.78, 4.46, 1.33, 0.20, 0.113, 0.046, 3.8),
    (TUMBLING, 25): Rms(5.31, 5.56, 0.526, 0.15, 0.092, 0.039, 4.2),
    (TUMBLING, 30): Rms(3.59, 3.44, 1.81, 0.104, 0.077, 0.048, 4.6),
    (TUMBLING, 35): Rms(4.31, 7.05, 1.103, 0.177, 0.07, 0.034, 5.0),
    (TUMBLING, 40): Rms(5.66, 3.90, 1.94, 0.12, 0.109, 0.037, 5.4),
    (TUMBLING, 45): Rms(7.20, 4.59, 1.81, 0.150, 0.116, 0.044, 5.8),
    (TUMBLING, 50): Rms(4.83, 6.64, 1.24, 0.126, 0.166, 0.039, 6.0),
}
"""RMS errors and CPU time of ICP with reverse calibration, by scenario and radius in px (Table 2)."""


class Norms(NamedTuple):
    """Error norms of one image."""

    attitude_deg: float
    position_m: float


NORMS = {
    (OBLIQUE, ICP): {7: Norms(7.68, 0.16), 18: Norms(8.33, 0.26), 19: Norms(12.46, 0.32)},
    (OBLIQUE, EPNP): {7: Norms(4.8, 0.13), 18: Norms(3.89, 0.18), 19: Norms(2.99, 0.11)},
    (TUMBLING, ICP): {4: Norms(15.73, 0.39), 7: Norms(25.91, 0.6), 9: Norms(23.27, 0.49)},
    (TUMBLING, EPNP): {4: Norms(4.72, 0.10), 7: Norms(4.35, 0.277), 9: Norms(2.7, 0.15)},
}
"""Error norms by scenario and technique, then by image, counted from one (Tables 3 and 4)."""
