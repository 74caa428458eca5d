"""A method of another package is treated like the project's own."""

from types import SimpleNamespace

import numpy as np
import pytest

from rpod_pose.lidar import methods as of_lidar
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.methods import methods_of
from rpod_pose.pmd import methods as of_pmd
from rpod_schemas.config.estimator import LidarInput, PmdInput
from rpod_target import load_target

ANGLES = np.radians(np.arange(-5.0, 6.0))
SENSORS = {
    "lidar": (LidarInput(), of_lidar, ScanPattern(ANGLES, ANGLES)),
    "pmd": (PmdInput(), of_pmd, ()),
}


class Tracking:
    def track(self, measurement, T_sensor_target):
        raise NotImplementedError


class Searching:
    def acquire(self, measurement):
        raise NotImplementedError

    def near(self, measurement, T_sensor_target):
        raise NotImplementedError


class Weighing(Searching):
    def log_likelihoods(self, _, found, /):
        return np.zeros(len(found))


@pytest.mark.parametrize(("acquirer", "weighs"), [(Searching(), False), (Weighing(), True)])
@pytest.mark.parametrize("kind", SENSORS)
def test_rivals_are_tracked_if_an_acquirer_weighs_poses_whatever_package_it_is_of(
    kind, acquirer, weighs, monkeypatch
):
    sensor, module, setup = SENSORS[kind]
    found = {sensor.tracking.kind: Tracking(), sensor.acquisition.kind: acquirer}
    monkeypatch.setattr(module, "method", lambda _, name: SimpleNamespace(built=lambda *_: found[name]))
    methods = methods_of(sensor, load_target("mockup"), setup)
    assert (methods.likelihoods is not None) == weighs
