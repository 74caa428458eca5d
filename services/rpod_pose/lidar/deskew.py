"""De-skewing: a scan's returns, moved to where they would have been at the scan's stamp.

A scan takes its time, 0.17 s by default, in which a target that tumbles at 8 deg/s turns by 1.3 deg. With
the twist that the filter predicts, each return is carried along with the target from its own time to the
stamp. The stamp is the middle of the scan, so even a wrong twist shifts the pose little: it bends the scan.

What follows for who compares returns with rays: the scan stays organised, but a moved return no longer
lies on the ray of its cell. It is off by the motion since its own time, 0.7 deg times its distance from the
axis of rotation over its range at most, in the same example: a part of a cell of 1 deg. The return was a
sample of the surface and still is one, so its distance to a face is sound; what the neighbouring ray meets
may differ near an outline, where the margin of a self-check has to cover it.
"""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import LidarScan


def deskewed(
    scan: LidarScan, T_sensor_target: RigidTransform, *, velocity_m_s: FloatArray, rate_rad_s: FloatArray
) -> LidarScan:
    """Return a scan as if all its returns had been measured at the stamp; itself where they were.

    A point of the target that is at p a time t after the stamp was at p0 + Exp(-w t) (p - p0 - v t) at the
    stamp, with the target's origin at p0.

    Args:
        scan: with or without times.
        T_sensor_target: at the stamp, as predicted.
        velocity_m_s: v, of the target's origin, sensor axes, shape (3,).
        rate_rad_s: w, of the target relative to the sensor, sensor axes, shape (3,).
    """
    if scan.time_s is None or not scan.time_s.any():
        return scan
    returned = np.isfinite(scan.points_m).all(axis=-1)
    since_s = scan.time_s[returned].astype(np.float64)[:, None]
    origin_m = T_sensor_target.translation
    arm_m = scan.points_m[returned] - origin_m - velocity_m_s * since_s
    points_m = scan.points_m.copy()
    points_m[returned] = origin_m + Rotation.from_rotvec(-rate_rad_s * since_s).apply(arm_m)
    return scan.model_copy(update={"points_m": points_m, "time_s": np.zeros_like(scan.time_s)})
