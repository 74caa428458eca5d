"""The emulated IMU, and a chaser that slews."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_motion import MotionError, build_motion
from rpod_motion.imu import Imu
from rpod_schemas.config.motion import (
    ApproachConfig,
    FixedAttitudeConfig,
    ImuNoiseConfig,
    MotionConfig,
    SlewConfig,
    StationKeepingConfig,
    TumbleConfig,
)

CENTRE_M = np.array([-0.4, 0.1, 0.05])
INERTIA_KG_M2 = np.diag([10.0, 12.0, 13.0])
TUMBLE = TumbleConfig(rate_deg_s=np.array([3.0, 5.0, 1.0]))
SLEW = SlewConfig(axis=np.array([1.0, 2.0, 0.5]), amplitude_deg=20.0, period_s=30.0)
SILENT = ImuNoiseConfig(
    gyro_noise_deg_sqrt_s=0.0, gyro_bias_sigma_deg_s=0.0, star_tracker_sigma_deg=0.0,
    acceleration_noise_m_s_sqrt_s=0.0, acceleration_bias_sigma_m_s2=0.0,
)  # fmt: skip


def a_motion(**fields):
    config = MotionConfig(**{"attitude": TUMBLE, "slew": SLEW} | fields)
    return build_motion(config, centre_of_mass_m=CENTRE_M, inertia_kg_m2=INERTIA_KG_M2, duration_s=40.0)


def an_imu(motion, config=SILENT, seed=1):
    return Imu(config, motion, centre_of_mass_m=CENTRE_M, seed=seed)


@pytest.mark.parametrize("trajectory", [ApproachConfig(), StationKeepingConfig()], ids=["line", "orbit"])
def test_a_slewing_chaser_sees_positions_and_rates_that_belong_together(trajectory):
    motion, step_s = a_motion(trajectory=trajectory), 1e-4
    for time_s in (0.0, 4.0, 17.3):
        before, here, after = (motion.state(time_s + off) for off in (-step_s, 0.0, step_s))
        R = here.T_chaser_target.rotation
        way = (after.T_chaser_target.translation - before.T_chaser_target.translation) / (2.0 * step_s)
        np.testing.assert_allclose(R.inv().apply(way), here.linear_m_s, atol=5e-5)
        turn = (before.T_chaser_target.rotation.inv() * after.T_chaser_target.rotation).as_rotvec()
        np.testing.assert_allclose(turn / (2.0 * step_s), here.angular_rad_s, atol=1e-6)
        own = Rotation.from_matrix(before.R_epoch_chaser.T @ after.R_epoch_chaser).as_rotvec()
        np.testing.assert_allclose(own / (2.0 * step_s), here.chaser_angular_rad_s, atol=1e-6)


def test_a_slew_beside_an_attitude_that_follows_the_chaser_is_refused():
    with pytest.raises(MotionError, match="choose spin or tumble"):
        a_motion(attitude=FixedAttitudeConfig())


def test_the_readings_are_the_rate_and_the_attitude_of_the_chaser():
    motion = a_motion(trajectory=StationKeepingConfig())
    reading, state = an_imu(motion).reading(5, 7.0), motion.state(7.0)
    np.testing.assert_array_equal(reading.rate_rad_s, state.chaser_angular_rad_s)
    np.testing.assert_allclose(reading.R_orbit_chaser.as_matrix(), state.R_orbit_chaser, atol=1e-12)
    np.testing.assert_array_equal(reading.force_m_s2, np.zeros(3))  # free flight


def test_the_thrust_of_an_approach_is_what_the_centre_of_mass_is_accelerated_by():
    motion = a_motion(slew=None, attitude=replace_rate(0.0), trajectory=ApproachConfig(ramp_share=0.5))
    force = an_imu(motion).reading(0, 5.0).force_m_s2
    speeds = [motion.state(5.0 + off).linear_m_s for off in (-0.01, 0.01)]
    R = motion.state(5.0).T_chaser_target.rotation
    np.testing.assert_allclose(force, -R.apply(speeds[1] - speeds[0]) / 0.02, atol=1e-5)
    assert np.linalg.norm(force) > 0.01


def replace_rate(rate_deg_s):
    return TUMBLE.model_copy(update={"rate_deg_s": np.full(3, rate_deg_s)})


def test_noise_is_keyed_by_seed_and_time_and_the_bias_lasts():
    motion, noisy = a_motion(), ImuNoiseConfig(gyro_noise_deg_sqrt_s=0.01, gyro_bias_sigma_deg_s=0.1)
    imu = an_imu(motion, noisy)
    times_s = np.arange(1000) / 50.0
    off = np.array([imu.reading(0, t).rate_rad_s - motion.state(t).chaser_angular_rad_s for t in times_s])
    np.testing.assert_array_equal(
        an_imu(motion, noisy).reading(0, 3.0).rate_rad_s, imu.reading(0, 3.0).rate_rad_s
    )
    assert imu.reading(0, 3.0).force_m_s2 is None
    sigma = np.radians(0.01) * np.sqrt(50.0)
    np.testing.assert_allclose(off.std(axis=0), sigma, rtol=0.1)
    np.testing.assert_allclose(off.mean(axis=0), imu.gyro_bias_rad_s, atol=4.0 * sigma / np.sqrt(1000))
    assert imu.reading(0, 3.0).rate_variance == pytest.approx(sigma**2)
    assert not np.array_equal(an_imu(motion, noisy, seed=2).gyro_bias_rad_s, imu.gyro_bias_rad_s)
