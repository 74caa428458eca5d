"""Crinkled foil: patches that tilt, belong to the target and move with it."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_schemas.config.motion import FACING
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.poses import make_pose
from rpod_sim_sensor.pmd import PmdEmulator
from rpod_sim_sensor.pmd.scene import crinkled
from rpod_target import load_target

R, T = Rotation.from_rotvec((0.3, -1.2, 0.4)).as_matrix(), np.array([0.1, -0.2, 3.0])


def tilts(points_m: np.ndarray, tilt_rad: float = 0.05) -> np.ndarray:
    return np.array([crinkled(*point, R, T, 20.0, tilt_rad) for point in points_m])


def test_tilts_have_the_spread_that_is_asked_for_and_no_direction() -> None:
    points_m = np.random.default_rng(1).uniform(-20, 20, (20_000, 3))
    spread = tilts(points_m)
    np.testing.assert_allclose(spread.std(axis=0), 0.05, rtol=0.03)
    np.testing.assert_allclose(spread.mean(axis=0), 0.0, atol=0.002)
    assert np.abs(np.corrcoef(spread.T) - np.eye(3)).max() < 0.03
    neighbours = tilts(points_m + 0.05 * R[0])  # one cell on
    assert abs(np.corrcoef(spread[:, 0], neighbours[:, 0])[0, 1]) < 0.03


def test_a_patch_is_as_large_as_asked_for() -> None:
    start = R.T @ (np.array([0.001, 0.02, 0.02]) - T)
    along = np.arange(0.0, 1.0, 0.005)
    values = tilts(start + along[:, None] * R[0])
    assert np.count_nonzero(np.diff(values[:, 0])) == 19


def glints(T_optical_target: RigidTransform) -> np.ndarray:
    config = PmdConfig(pixel={"read_noise_e": 0.0})
    emulator = PmdEmulator(config, load_target("mockup"), seed=1)
    return emulator.expose([T_optical_target] * 4, sun_W_m2=np.zeros(3), frame=0).amplitude.astype(float)


def test_glints_move_with_the_target() -> None:
    config = PmdConfig()
    still = glints(make_pose(rotation=FACING, translation_m=(0.0, 0.0, 4.0)))
    columns = 40
    aside_m = columns * 4.0 / config.camera.fx
    moved = glints(make_pose(rotation=FACING, translation_m=(aside_m, 0.0, 4.0)))
    one, other = np.minimum(still[:, 80:260], 500), np.minimum(moved[:, 80 + columns : 260 + columns], 500)
    assert np.corrcoef(one.ravel(), other.ravel())[0, 1] > 0.9
