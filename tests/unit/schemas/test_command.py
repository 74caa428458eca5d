"""Commanded accelerations on the wire."""

import numpy as np
import pytest

from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import read_command, write_command
from rpod_schemas.rmw.cdr import decode, encode
from rpod_schemas.topics import CHASER, COMMAND
from rpod_schemas.types import Command

WHOLE = Command(
    stamp_ns=10**18, frame_id=CHASER, acceleration_m_s2=np.array([0.01, -0.02, 0.03]), variance=9e-8
)


def wired(command):
    return decode(memoryview(bytes(encode(write_command(command)))), COMMAND.type)


def test_a_command_survives_the_wire():
    got = read_command(wired(WHOLE))
    assert (got.stamp_ns, got.variance) == (WHOLE.stamp_ns, pytest.approx(WHOLE.variance))
    np.testing.assert_array_equal(got.acceleration_m_s2, WHOLE.acceleration_m_s2)


@pytest.mark.parametrize(
    ("place", "value", "reason", "text"),
    [
        (0, np.nan, Reason.NOT_FINITE, "covariance holds"),
        (14, -1e-6, Reason.MALFORMED, "needs 0 or more; send 0 for unknown"),
        (7, 1e4, Reason.MALFORMED, "variance"),
    ],
)
def test_a_covariance_that_is_none_is_rejected(place, value, reason, text):
    message = wired(WHOLE)
    message.accel.covariance = np.where(np.arange(36) == place, value, message.accel.covariance)
    with pytest.raises(MessageRejectedError, match=text) as raised:
        read_command(message)
    assert raised.value.reason == reason


@pytest.mark.parametrize("value", [np.nan, 25.0])
def test_an_acceleration_beyond_the_limits_is_rejected(value):
    message = wired(WHOLE)
    message.accel.accel.linear.y = value
    with pytest.raises(MessageRejectedError, match="acceleration_m_s2"):
        read_command(message)


def test_commands_in_other_axes_are_rejected():
    with pytest.raises(MessageRejectedError, match="turn the command"):
        read_command(write_command(WHOLE.model_copy(update={"frame_id": "orbit"})))
