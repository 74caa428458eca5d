"""The pose of a target in one scan by a single function, for notebooks and scripts."""

from functools import lru_cache, partial

import numpy as np

from rpod_pose.lidar.global_search import GlobalSearch
from rpod_pose.lidar.noisy_ranges import NoisyScanSearch
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.ports import Acquisition
from rpod_schemas.config.lidar.search import GlobalSearchConfig
from rpod_schemas.types import LidarInfo, LidarScan
from rpod_target import Target


def acquire(scan: LidarScan, target: Target, sensor: LidarInfo) -> Acquisition:
    """Return the pose of a target in one scan, found without a guess by the facility's own search.

    The first call for a target and a sensor prepares the search in about a second; later calls take
    milliseconds. A service that configures the search uses ``lidar.methods`` instead.

    Args:
        scan: the scan, organised in the sensor's rows and columns or not.
        target: target with a distance field.
        sensor: info of the LIDAR: scan pattern, within 90 deg of the boresight, and sigma of a range.

    Returns:
        T_sensor_target as ``pose``, its ``covariance`` of (dp, dtheta) in the sensor's fixed axes, shape
        (6, 6), the ``outcome``, the ``belief`` with its reason, and the weighted ``hypotheses``.

    Raises:
        rpod_target.TargetError: the target has no distance field.

    Example:
        >>> from rpod_schemas.config.lidar import LidarConfig
        >>> from rpod_schemas.poses import make_pose
        >>> from rpod_sim_sensor.lidar import LidarEmulator
        >>> from rpod_target import load_target
        >>> target, lidar = load_target("envisat-bulky"), LidarConfig()
        >>> truth = make_pose(translation_m=[0.0, 0.0, 30.0])
        >>> returns = LidarEmulator(lidar, target, seed=1).scan([truth], frame=0)
        >>> scan = LidarScan(stamp_ns=0, frame_id="lidar", points_m=returns.points_m)
        >>> found = acquire(scan, target, lidar.info())
        >>> str(found.outcome)
        'accepted'
        >>> bool((truth.inv() * found.pose).rotation.magnitude() < 0.01)
        True
    """
    aside_rad = sensor.row_azimuth_rad
    known = [sensor.azimuth_rad, sensor.elevation_rad, *(() if aside_rad is None else (aside_rad,))]
    angles = tuple(each.tobytes() for each in known)
    return _search(target, angles, sensor.sigma_range_m).acquire(scan)


@lru_cache(maxsize=8)
def _search(target: Target, angles: tuple[bytes, ...], sigma_range_m: float) -> NoisyScanSearch:
    azimuth_rad, elevation_rad, *aside_rad = map(np.frombuffer, angles)
    pattern = ScanPattern(azimuth_rad, elevation_rad, sigma_range_m, *aside_rad)
    return NoisyScanSearch(partial(GlobalSearch, GlobalSearchConfig(), target), pattern)
