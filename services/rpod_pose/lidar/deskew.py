"""De-skewing: motion of a scan's returns to where they would have been measured at the scan's stamp.

A scan takes 0.17 s by default. In this time a target that tumbles at 8 deg/s turns by 1.3 deg. With the twist
that the filter predicts, each return is moved along with the target from its own time to the stamp. The stamp
is the middle of the scan, so that a wrong twist deforms the scan but shifts the pose little.

The scan stays organised, but a moved return no longer lies on the ray of its cell. The difference is the
motion since the return's own time: in the example at most 0.7 deg times the return's distance from the axis
of rotation over its range, which is a part of a cell of 1 deg. The return is still a sample of the surface,
so its distance from a face is valid. Near an outline the neighbouring ray may meet another surface. The
margin of a self-check must cover this.
"""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.rays import NEAREST_M
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import LidarScan


def deskewed(
    scan: LidarScan, T_sensor_target: RigidTransform, *, velocity_m_s: FloatArray, rate_rad_s: FloatArray
) -> LidarScan:
    """Return a scan as if all its returns had been measured at the stamp; unchanged if it has no times.

    A point of the target that is measured at p at the time t after the stamp was at
    p0 + Exp(-w t) (p - p0 - v t) at the stamp, where p0 is the position of the target's origin at the stamp.

    Args:
        scan: scan with or without times.
        T_sensor_target: predicted pose at the stamp.
        velocity_m_s: v, velocity of the target's origin, sensor axes, shape (3,).
        rate_rad_s: w, rate of the target relative to the sensor, sensor axes, shape (3,).
    """
    if scan.time_s is None or not scan.time_s.any():
        return scan
    returned = np.isfinite(scan.points_m).all(axis=-1) & (np.linalg.norm(scan.points_m, axis=-1) > NEAREST_M)
    since_s = scan.time_s[returned].astype(np.float64)[:, None]
    origin_m = T_sensor_target.translation
    arm_m = scan.points_m[returned] - origin_m - velocity_m_s * since_s
    points_m = scan.points_m.copy()
    points_m[returned] = origin_m + Rotation.from_rotvec(-rate_rad_s * since_s).apply(arm_m)
    return scan.model_copy(update={"points_m": points_m, "time_s": np.zeros_like(scan.time_s)})
