"""Joints of an emulated target."""

import numpy as np
import pytest

from rpod_emulator.joints import MovingJoints
from rpod_schemas.config.emulator import EmulatorConfig
from rpod_schemas.errors import ConfigurationError
from rpod_target import load_target

SENSORS = [{"kind": "lidar", "name": "lidar"}]


def config(**joints):
    return EmulatorConfig.model_validate({"target": "mockup", "sensors": SENSORS, "joints": joints})


def test_a_joint_that_the_target_has_not_is_refused():
    with pytest.raises(ConfigurationError, match="mockup has no such joint; its file declares none"):
        MovingJoints(config(array={"angle_deg": 10}), load_target("mockup"))


def test_an_angle_follows_the_configured_rate():
    moving = config(array={"angle_deg": 10, "rate_deg_s": -2}).joints["array"]
    assert np.rad2deg(moving.angle_rad(3.0)) == pytest.approx(4.0)
    assert not MovingJoints(config(), load_target("mockup")).turn
