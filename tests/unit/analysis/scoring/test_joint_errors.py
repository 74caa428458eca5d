"""Errors of the angles of joints, against the truth at the estimates' stamps."""

from types import SimpleNamespace

import numpy as np
import pytest

from rpod_analysis.scoring.joint_errors import joint_errors
from rpod_schemas.messages import NANOSECONDS, write_joints
from rpod_schemas.types import Joints


def joints(time_s, **angles_deg):
    angles_rad = {name: np.deg2rad(angle) for name, angle in angles_deg.items()}
    return write_joints(
        Joints(
            stamp_ns=round(time_s * NANOSECONDS),
            angle_rad=angles_rad,
            rate_rad_s=dict.fromkeys(angles_rad, 0.0),
        )
    )


class FakeLog:
    def __init__(self, **topics):
        self.topics = {name.replace("_", "/"): messages for name, messages in topics.items()}

    def messages(self, topic):
        return [SimpleNamespace(decode=lambda message=message: message) for message in self.topics[topic]]


def test_the_truth_is_interpolated_and_nothing_is_scored_beside_it():
    truth = [joints(0.0, array=0.0), joints(2.0, array=4.0, other=1.0)]
    estimates = [joints(-1.0, array=50.0), joints(0.5, array=2.0), joints(1.0, array=2.0)]
    found = joint_errors(FakeLog(truth_joints=truth, estimate_joints=estimates), prefix="estimate")
    assert list(found) == ["array"]
    assert found["array"].max == pytest.approx(1.0)
    assert found["array"].rms == pytest.approx(np.sqrt(0.5))


def test_a_log_without_joints_has_no_errors_of_them():
    assert not joint_errors(FakeLog(), prefix="estimate")
