"""Packets of three LIDARs that see the mock-up move, written from the manuals of their makers.

This emulator shares no code with the facility: numpy alone, one ray for each firing, at its own time.
The head's axes are x forward, y left, z up; azimuths count from x to the right, as heads turn.
README.md tells which tools made clouds of these packets.
"""

import struct
from datetime import UTC, datetime

import numpy as np

BEGIN_S = 1_750_000_000.0
"""Begin of the scan, s since 1970; it takes SCAN_S."""
SCAN_S = 0.1
PLACE_M = np.array([6.0, 0.1, -0.05])
"""Target's origin in the middle of the scan, head's axes."""
VELOCITY_MPS = np.array([-0.6, 0.8, 0.3])
YAW_PITCH_ROLL_DEG = (155.0, 20.0, 10.0)
STRENGTH = 80
"""Intensity of each return."""


def rotation():
    """Return R_head_target, shape (3, 3)."""
    (cy, cp, cr), (sy, sp, sr) = (
        np.cos(np.radians(YAW_PITCH_ROLL_DEG)),
        np.sin(np.radians(YAW_PITCH_ROLL_DEG)),
    )
    yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    pitch = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return yaw @ pitch @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])


def origin_m(since_s):
    """Return the target's origin at times since BEGIN_S, head's axes, shape (N, 3)."""
    return PLACE_M + VELOCITY_MPS * (np.asarray(since_s)[..., None] - SCAN_S / 2)


def ranges_m(triangles_m, origins_m, rays, since_s):
    """Return the first hits along N rays, 0 without one (Moeller and Trumbore, 1997)."""
    at, along = (origins_m - origin_m(since_s)) @ rotation(), rays @ rotation()
    nearest = np.full(len(along), np.inf)
    for corner, second, third in triangles_m:
        one, two = second - corner, third - corner
        across = np.cross(along, two)
        with np.errstate(all="ignore"):
            scale = across @ one
            begin = at - corner
            u = (begin * across).sum(1) / scale
            turned = np.cross(begin, one)
            v = (along * turned).sum(1) / scale
            range_m = turned @ two / scale
        hit = (np.abs(scale) > 1e-12) & (u >= 0) & (v >= 0) & (u + v <= 1) & (range_m > 0)
        nearest = np.where(hit & (range_m < nearest), range_m, nearest)
    return np.where(np.isfinite(nearest), nearest, 0.0)


def rays(azimuth, elevation):
    return np.stack(
        [np.cos(elevation) * np.cos(azimuth), -np.cos(elevation) * np.sin(azimuth), np.sin(elevation)],
        axis=-1,
    )


def steps_of(triangles_m, azimuth, elevation, since_s, *, step_m, above_m=0.0):
    """Return the ranges as a head sends them: integers of a step, 0 without a return."""
    ahead = np.abs(np.angle(np.exp(1j * azimuth))) < 0.4
    found = np.zeros(since_s.shape, int)
    if ahead.any():
        above = np.broadcast_to(above_m, since_s.shape)[..., None] * rays(azimuth, elevation + np.pi / 2)
        hit = ranges_m(triangles_m, above[ahead], rays(azimuth, elevation)[ahead], since_s[ahead])
        found[ahead] = np.round(hit / step_m)
    return found


VLP16_DEG = np.array([-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15], float)
VLP16_ABOVE_MM = np.array(
    [11.2, -0.7, 9.7, -2.2, 8.1, -3.7, 6.6, -5.1, 5.1, -6.6, 3.7, -8.1, 2.2, -9.7, 0.7, -11.2]
)


def vlp16(triangles_m):
    """Return (time of the first firing, packet) of a turn that begins behind the head.

    VLP-16 user manual 63-9243, sections 6 and 9: strongest return, 24 firings of 16 lasers a packet.
    """
    packets = []
    for number in range(75):
        begin_s = number * 24 * 55.296e-6
        since_s = begin_s + np.arange(24)[:, None] * 55.296e-6 + np.arange(16) * 2.304e-6
        azimuth = np.pi + 2 * np.pi * since_s / SCAN_S
        elevation = np.broadcast_to(np.radians(VLP16_DEG), since_s.shape)
        found = steps_of(triangles_m, azimuth, elevation, since_s, step_m=0.002, above_m=VLP16_ABOVE_MM / 1e3)
        data = b""
        for block in range(12):
            data += b"\xff\xee" + struct.pack("<H", round(np.degrees(azimuth[2 * block, 0]) * 100) % 36_000)
            for steps in found[2 * block : 2 * block + 2].ravel():
                data += struct.pack("<HB", steps, STRENGTH if steps else 0)
        past_the_hour_us = round((BEGIN_S % 3600 + begin_s) * 1e6)
        packets.append((BEGIN_S + begin_s, data + struct.pack("<IBB", past_the_hour_us, 0x37, 0x22)))
    return packets


def pandar_xt32(triangles_m, azimuths_deg, elevations_deg):
    """Return (time, packet) of a turn of a head whose azimuth of 90 deg is forward.

    Pandar XT-32 user manual, UDP 6.1: strongest return, 8 blocks of 32 channels a packet.
    Times are those of its appendix B.
    The angles of the channels are those of the calibration file that the decoder has.
    """
    packets = []
    for number in range(250):
        end_s = (number + 1) * 8 * 50e-6
        since_s = end_s + (3.28 + 0.28 - 50.0 * (7 - np.arange(8))[:, None] + 1.512 * np.arange(32)) * 1e-6
        block = 2 * np.pi * (since_s[:, 0] - 0.28e-6) / SCAN_S
        azimuth = block[:, None] + np.radians(azimuths_deg) - np.pi / 2
        elevation = np.broadcast_to(np.radians(elevations_deg), since_s.shape)
        found = steps_of(triangles_m, azimuth, elevation, since_s, step_m=0.004)
        data = struct.pack("!4BH6B", 0xEE, 0xFF, 6, 1, 0, 32, 8, 1, 4, 1, 0)
        for angle, row in zip(block, found, strict=True):
            data += struct.pack("<H", round(np.degrees(angle) * 100) % 36_000)
            data += b"".join(struct.pack("<HBB", steps, STRENGTH if steps else 0, 0) for steps in row)
        at = datetime.fromtimestamp(BEGIN_S + end_s, UTC)
        data += struct.pack("!9sBBH", bytes(9), 0, 0x37, 600)
        data += struct.pack("6B", at.year - 1900, at.month, at.day, at.hour, at.minute, at.second)
        data += struct.pack("<IBI", at.microsecond, 0x42, number)
        packets.append((BEGIN_S + end_s, data))
    return packets


def livox(triangles_m, points=480):
    """Return packets of Cartesian points in mm of a rosette of ours within 10 deg of x.

    Livox SDK2 communication protocol, point cloud data type 1, PTP: 24 points a packet.
    """
    since_s = np.arange(points) * (SCAN_S / points)
    angle = 2 * np.pi * 41.0 * since_s
    radius = np.radians(10.0) * np.cos(2.618 * angle)
    along = rays(radius * np.cos(angle), radius * np.sin(angle))
    hit_m = ranges_m(triangles_m, np.zeros((points, 3)), along, since_s)
    points_mm = np.round(1e3 * along * hit_m[:, None]).astype(int)
    packets = []
    for number, first in enumerate(range(0, points, 24)):
        cells = b"".join(
            struct.pack("<iiiBB", *point, STRENGTH if point.any() else 0, 0)
            for point in points_mm[first : first + 24]
        )
        takes = round(24 * SCAN_S / points / 1e-7)
        data = struct.pack("<BHHHHBBB12sI", 0, 36 + len(cells), takes, 24, number, 0, 1, 1, bytes(12), 0)
        data += struct.pack("<Q", round(BEGIN_S * 1e9) + round(since_s[first] * 1e9))
        packets.append(data + cells)
    return packets
