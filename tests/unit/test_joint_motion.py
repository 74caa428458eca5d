"""The motion of joints in a scenario against the joints of its target."""

from types import SimpleNamespace

import numpy as np
import pytest

from rpod.play.joint_motion import beyond
from rpod.scenarios import find
from rpod_schemas.config.motion import JointMotionConfig
from rpod_schemas.errors import ConfigurationError


def told(name, **motion):
    scenario = find("mockup-approach")
    joints = {name: JointMotionConfig(**motion)}
    scenario = scenario.model_copy(
        update={"motion": scenario.motion.model_copy(update={"joints": joints}), "duration_s": 10.0}
    )
    drive = SimpleNamespace(
        name="drive", limits_rad=tuple(np.radians([-60.0, 60.0])), rate_rad_s=np.radians(1.0)
    )
    return beyond(scenario, SimpleNamespace(name="sat", joints=(drive,)))


def test_a_joint_that_the_target_does_not_have_is_refused():
    with pytest.raises(ConfigurationError, match=r"motion\.joints\.drvie: is no joint of sat; it has drive"):
        told("drvie")


def test_angles_and_rates_beyond_those_of_the_file_are_told():
    assert told("drive", angle_deg=50.0, rate_deg_s=1.0) == []
    (far,) = told("drive", angle_deg=100.0)
    assert "goes from 100 to 100 deg, and limits_deg of the target's file are -60 to 60" in far
    (fast,) = told("drive", rate_deg_s=-3.0)
    assert "rate_deg_s: is -3, and most_rate_deg_s of the target's file is 1" in fast
