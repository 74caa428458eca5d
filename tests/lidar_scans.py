"""Scans for the LIDAR's methods: of known poses, from the emulated sensor, and such as no sensor sends."""

from functools import cache

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.lidar.global_search import GlobalSearch
from rpod_pose.lidar.projective_icp import ProjectiveIcp
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.lidar.search import GlobalSearchConfig, ProjectiveIcpConfig
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.types import LidarScan
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_target import load_target

LIDAR = LidarConfig()
DENSE = LidarConfig(
    rate_hz=0.4, pattern={"azimuth_span_deg": 30.0, "elevation_span_deg": 30.0, "step_deg": 0.2}
)
BULKY = "envisat-bulky"

load = cache(load_target)


@cache
def emulator(target=BULKY, lidar=LIDAR):
    return LidarEmulator(lidar, load(target), seed=5)


@cache
def search(target=BULKY, lidar=LIDAR):
    return GlobalSearch(GlobalSearchConfig(), load(target), ScanPattern.of(lidar.info()))


@cache
def tracker(target=BULKY, lidar=LIDAR):
    return ProjectiveIcp(ProjectiveIcpConfig(), load(target), ScanPattern.of(lidar.info()))


def scan_of(points_m, time_s=None):
    return LidarScan(stamp_ns=0, frame_id="lidar", points_m=np.asarray(points_m, np.float32), time_s=time_s)


def scan_at(T_lidar_target, target=BULKY, frame=0, lidar=LIDAR):
    return scan_of(emulator(target, lidar).scan([T_lidar_target], frame=frame).points_m)


def nees(T, found):
    """Return the squared error of a registration over its covariance."""
    turn = (found.T_sensor_target.rotation * T.rotation.inv()).as_rotvec()
    error = np.concatenate((found.T_sensor_target.translation - T.translation, turn))
    return error @ np.linalg.solve(found.covariance, error)


def random_pose(seed, range_m=20.0):
    """Return a target at a range, a little off the boresight, in any attitude."""
    random = np.random.default_rng(seed)
    x_m, y_m = random.uniform(-0.5, 0.5, 2)
    return make_pose(rotation=Rotation.random(rng=random), translation_m=(x_m, y_m, range_m))


def off(T, angle_deg, offset_m, seed):
    """Return a pose turned and shifted by these amounts, in random directions."""
    axis, way = np.random.default_rng(seed).normal(size=(2, 3))
    turn = Rotation.from_rotvec(np.deg2rad(angle_deg) * axis / np.linalg.norm(axis))
    return T * RigidTransform.from_components(offset_m * way / np.linalg.norm(way), turn)


def errors(T_truth, T):
    """Return the angle, deg, and the distance, m, between two poses."""
    attitude_rad, position_m = pose_error(T_truth, T)
    return np.rad2deg(np.linalg.norm(attitude_rad)), np.linalg.norm(position_m)


@cache
def strange_scans():
    """Return scans that show no target, by what is strange about them."""
    random, rays = np.random.default_rng(9), tracker().view.grid.directions
    x_m, y_m = np.meshgrid(*[np.linspace(-3.0, 3.0, 12)] * 2)
    ahead_m = np.array((0.0, 0.0, 20.0))
    one = np.full(rays.shape, np.nan)
    one[20, 20] = ahead_m
    points_m = {
        "no returns": np.full(rays.shape, np.nan),
        "no points": np.empty((0, 3)),
        "one return": one,
        "three points": [(0.0, 0.0, 20.0), (0.3, 0.0, 20.0), (0.0, 0.3, 20.0)],
        "one place": np.tile(ahead_m, (50, 1)),
        "a cross": np.vstack([np.linspace(end_m, -end_m, 60) + ahead_m for end_m in 5.0 * np.eye(3)[:2]]),
        "a plate": np.dstack((x_m, y_m, np.full_like(x_m, 20.0))).reshape(-1, 3),
        "a sphere around the sensor": 20.0 * rays,
        "a few random points": random.uniform((-5.0, -5.0, 15.0), (5.0, 5.0, 25.0), (12, 3)),
        "random points": random.uniform((-5.0, -5.0, 15.0), (5.0, 5.0, 25.0), (300, 3)),
        "random ranges": random.uniform(15.0, 25.0, (*rays.shape[:2], 1)) * rays,
        "behind": -20.0 * rays,
        "infinite": np.full(rays.shape, np.inf),
        "huge": np.full(rays.shape, 3e38),
        "both huge": random.choice((-3e38, 3e38), rays.shape),
        "zero": np.zeros(rays.shape),
        "tiny": np.full(rays.shape, 1e-30),
    }
    return {name: scan_of(points) for name, points in points_m.items()}
