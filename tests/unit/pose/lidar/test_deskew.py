"""De-skewing against motions whose result is known, and against emulated scans of a tumbling target."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.lidar.deskew import deskewed
from rpod_pose.lidar.projective_icp import ProjectiveIcp
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.measurement import Measurement
from rpod_pose.navigation.filter import FilterState
from rpod_pose.navigation.frames import as_of_stamp
from rpod_schemas.config.lidar import LidarConfig, LidarDetectionConfig, LidarNoiseConfig
from rpod_schemas.config.lidar.search import ProjectiveIcpConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import LidarScan
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_target import load_target

POSE = make_pose(rotation=Rotation.from_rotvec([0.3, -0.8, 0.4]), translation_m=[1.0, -2.0, 25.0])
VELOCITY_M_S, RATE_RAD_S = np.array([0.3, -0.2, 0.5]), np.deg2rad([5.0, -4.0, 4.8])
VECTORS = st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).map(np.array)


def pose_at(time_s: float) -> RigidTransform:
    """Return T_sensor_target."""
    return make_pose(
        rotation=Rotation.from_rotvec(RATE_RAD_S * time_s) * POSE.rotation,
        translation_m=POSE.translation + VELOCITY_M_S * time_s,
    )


def scan_of(points_m: np.ndarray, time_s: np.ndarray | None) -> LidarScan:
    times = None if time_s is None else time_s.astype(np.float32)
    return LidarScan(stamp_ns=7, frame_id="lidar", points_m=points_m.astype(np.float32), time_s=times)


def skewed(local_m: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return points of the target where they are at their times, sensor axes, shape (rows, columns, 3)."""
    moments = time_s.ravel()
    points = [
        pose_at(moment).apply(point) for moment, point in zip(moments, local_m.reshape(-1, 3), strict=True)
    ]
    return np.array(points).reshape(local_m.shape)


def test_points_of_a_moving_target_come_to_where_they_were_at_the_stamp() -> None:
    rng = np.random.default_rng(1)
    local_m, time_s = rng.uniform(-10.0, 10.0, (4, 5, 3)), rng.uniform(-0.1, 0.1, (4, 5))
    moved = deskewed(
        scan_of(skewed(local_m, time_s), time_s), POSE, velocity_m_s=VELOCITY_M_S, rate_rad_s=RATE_RAD_S
    )
    np.testing.assert_allclose(moved.points_m, POSE.apply(local_m.reshape(-1, 3)).reshape(4, 5, 3), atol=1e-5)
    assert moved.stamp_ns == 7
    assert not moved.time_s.any()


def test_rows_columns_and_gaps_are_kept_and_the_scan_itself_is_left_alone() -> None:
    points_m = np.full((3, 4, 3), np.nan)
    points_m[1, 2] = [1.0, 2.0, 30.0]
    points_m[2, 3] = 0.0  # as many sensors say that a ray did not return
    scan = scan_of(points_m, np.linspace(-0.1, 0.1, 12).reshape(3, 4))
    before = scan.points_m.copy()
    moved = deskewed(scan, POSE, velocity_m_s=VELOCITY_M_S, rate_rad_s=RATE_RAD_S)
    np.testing.assert_array_equal(np.isfinite(moved.points_m), np.isfinite(points_m))
    np.testing.assert_array_equal(moved.points_m[2, 3], 0.0)
    np.testing.assert_array_equal(scan.points_m, before)


@pytest.mark.parametrize("time_s", [None, np.zeros(6)], ids=["no times", "all at the stamp"])
def test_a_scan_without_offsets_is_returned_as_it_is(time_s: np.ndarray | None) -> None:
    scan = scan_of(np.ones((6, 3)), time_s)
    assert deskewed(scan, POSE, velocity_m_s=VELOCITY_M_S, rate_rad_s=RATE_RAD_S) is scan


def test_an_unorganised_and_an_empty_scan_will_do() -> None:
    for points_m in (np.ones((6, 3)), np.empty((0, 3)), np.full((2, 2, 3), np.nan)):
        scan = scan_of(points_m, np.full(points_m.shape[:-1], 0.05))
        moved = deskewed(scan, POSE, velocity_m_s=VELOCITY_M_S, rate_rad_s=RATE_RAD_S)
        assert moved.points_m.shape == points_m.shape


@settings(deadline=None)
@given(velocity_m_s=VECTORS, rate_rad_s=VECTORS)
def test_distances_within_a_row_that_is_taken_at_once_are_kept(velocity_m_s, rate_rad_s) -> None:
    points_m = np.random.default_rng(2).uniform(-5.0, 5.0, (1, 8, 3)) + POSE.translation
    moved = deskewed(
        scan_of(points_m, np.full((1, 8), 0.08)), POSE, velocity_m_s=velocity_m_s, rate_rad_s=rate_rad_s
    )
    before_m, after_m = (np.linalg.norm(np.diff(each, axis=1), axis=2) for each in (points_m, moved.points_m))
    np.testing.assert_allclose(after_m, before_m, atol=1e-5)


def test_the_filters_twist_in_chaser_axes_is_taken_through_the_sensors_mount() -> None:
    T_chaser_sensor = make_pose(
        rotation=Rotation.from_rotvec([0.2, 1.0, -0.3]), translation_m=[0.5, 0.1, 1.0]
    )
    rng = np.random.default_rng(3)
    local_m, time_s = rng.uniform(-10.0, 10.0, (3, 3, 3)), rng.uniform(-0.1, 0.1, (3, 3))
    predicted = FilterState(
        7,
        T_chaser_sensor * POSE,
        T_chaser_sensor.rotation.apply(VELOCITY_M_S),
        T_chaser_sensor.rotation.apply(RATE_RAD_S),
        np.eye(12),
    )
    measurement = Measurement("lidar", scan_of(skewed(local_m, time_s), time_s), T_chaser_sensor)
    moved = as_of_stamp(measurement, predicted, deskewed)
    np.testing.assert_allclose(moved.points_m, POSE.apply(local_m.reshape(-1, 3)).reshape(3, 3, 3), atol=1e-5)


def test_an_emulated_skewed_scan_lies_on_the_target_again() -> None:
    """Without noise what is left is what a row moves in its own time: the emulator sees a row at once."""
    quiet = LidarNoiseConfig(sigma_range_m=0.0, sigma_pointing_rad=0.0, outlier_share=0.0)
    config = LidarConfig(motion="skewed", noise=quiet, detection=LidarDetectionConfig(false_alarm=1e-4))
    target = load_target("envisat-bulky")
    returns = LidarEmulator(config, target, seed=4).scan([pose_at(t) for t in config.pose_times_s()], frame=1)
    scan = LidarScan(stamp_ns=7, frame_id="lidar", points_m=returns.points_m, time_s=returns.time_s)
    moved = deskewed(scan, POSE, velocity_m_s=VELOCITY_M_S, rate_rad_s=RATE_RAD_S)

    def off_m(each: LidarScan) -> float:
        local_m = POSE.inv().apply(each.returns_m.astype(float))
        to_planes = np.einsum("tk,ptk->pt", target.normals, local_m[:, None] - target.triangles_m[:, 0])
        return float(np.quantile(np.abs(to_planes).min(axis=1), 0.9))

    assert off_m(moved) < 0.005
    assert off_m(scan) > 0.03


def test_the_covariance_of_a_scan_that_was_de_skewed_holds() -> None:
    """Ten scans while the target turns at 8 deg/s: NEES 231 with rays that stayed where they were."""
    target, config = load_target("envisat-bulky"), LidarConfig(motion="skewed")
    emulator = LidarEmulator(config, target, seed=4)
    tracker = ProjectiveIcp(ProjectiveIcpConfig(), target, ScanPattern.of(config.info()))
    nees = []
    for frame in range(10):
        attitude = Rotation.random(rng=np.random.default_rng(frame))

        def pose(time_s: float, attitude: Rotation = attitude) -> RigidTransform:
            return make_pose(
                rotation=Rotation.from_rotvec(RATE_RAD_S * time_s) * attitude,
                translation_m=[0.0, 0.0, 20.0] + VELOCITY_M_S * time_s,
            )

        returns = emulator.scan([pose(t) for t in config.pose_times_s()], frame=frame)
        scan = LidarScan(stamp_ns=7, frame_id="lidar", points_m=returns.points_m, time_s=returns.time_s)
        moved = deskewed(scan, pose(0.0), velocity_m_s=VELOCITY_M_S, rate_rad_s=RATE_RAD_S)
        found = tracker.track(moved, pose(0.0))
        turn = (pose(0.0).rotation * found.T_sensor_target.rotation.inv()).as_rotvec()
        error = np.concatenate((pose(0.0).translation - found.T_sensor_target.translation, turn))
        nees.append(error @ np.linalg.solve(found.covariance, error))
    assert np.mean(nees) < 10.0, nees
