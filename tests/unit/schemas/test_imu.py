"""Readings of the chaser's IMU on the wire."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import read_imu, write_imu
from rpod_schemas.rmw.cdr import decode, encode
from rpod_schemas.topics import CHASER, IMU
from rpod_schemas.types import ImuReading

WHOLE = ImuReading(
    stamp_ns=10**18,
    frame_id=CHASER,
    rate_rad_s=np.array([0.01, -0.02, 0.03]),
    rate_variance=4e-8,
    force_m_s2=np.array([0.1, 0.0, -0.2]),
    force_variance=9e-6,
    R_orbit_chaser=Rotation.from_euler("zyx", [0.3, -0.2, 1.0]),
)


def wired(reading, **changes):
    message = write_imu(reading)
    for name, value in changes.items():
        setattr(message, name, value)
    return decode(memoryview(bytes(encode(message))), IMU.type)


def test_a_reading_survives_the_wire():
    got = read_imu(wired(WHOLE))
    assert (got.stamp_ns, got.rate_variance) == (WHOLE.stamp_ns, pytest.approx(WHOLE.rate_variance))
    assert got.force_variance == pytest.approx(WHOLE.force_variance)
    np.testing.assert_array_equal(got.rate_rad_s, WHOLE.rate_rad_s)
    np.testing.assert_array_equal(got.force_m_s2, WHOLE.force_m_s2)
    assert (got.R_orbit_chaser * WHOLE.R_orbit_chaser.inv()).magnitude() < 1e-12


def test_what_is_not_measured_is_absent():
    bare = ImuReading(stamp_ns=10**18, frame_id=CHASER, rate_rad_s=np.zeros(3))
    got = read_imu(wired(bare))
    assert got.force_m_s2 is None
    assert got.R_orbit_chaser is None
    assert got.rate_variance == got.force_variance == 0.0


@pytest.mark.parametrize(
    ("changes", "reason", "text"),
    [
        ({"angular_velocity_covariance": np.full(9, -1.0)}, Reason.MALFORMED, "absent"),
        ({"angular_velocity_covariance": np.full(9, np.nan)}, Reason.NOT_FINITE, "covariance"),
        ({"linear_acceleration_covariance": np.full(9, np.nan)}, Reason.NOT_FINITE, "linear acceleration"),
    ],
)
def test_a_reading_without_a_usable_rate_or_covariance_is_rejected(changes, reason, text):
    with pytest.raises(MessageRejectedError, match=text) as raised:
        read_imu(wired(WHOLE, **changes))
    assert raised.value.reason == reason


def test_readings_in_other_axes_are_rejected():
    with pytest.raises(MessageRejectedError, match="turn the readings"):
        read_imu(write_imu(WHOLE.model_copy(update={"frame_id": "imu"})))


@pytest.mark.parametrize("value", [np.nan, 2e4])
def test_a_rate_beyond_the_limits_is_rejected(value):
    with pytest.raises(MessageRejectedError, match="rate_rad_s"):
        read_imu(wired(WHOLE.model_copy(update={"rate_rad_s": np.array([value, 0.0, 0.0])})))
