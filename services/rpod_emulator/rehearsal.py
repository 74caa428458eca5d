"""Frames without a bus: they load all code before the emulator joins it, as a process in reserve must."""

import os
from contextlib import suppress

from rpod_emulator.channels import open_channel
from rpod_emulator.joints import MovingJoints
from rpod_runtime.local_node import local_node
from rpod_runtime.process.reserve import RESERVE
from rpod_schemas.config.emulator import EmulatorConfig
from rpod_target import Target


def rehearse(config: EmulatorConfig, target: Target) -> None:
    """Make one frame of each sensor, if this process is in reserve; others do so when they open the sensors.

    Raises:
        ConfigurationError: a sensor cannot be emulated.
    """
    if not os.environ.get(RESERVE):
        return
    still = MovingJoints(config, target).at(0.0)
    for sensor in config.sensors:
        # a sensor kind of another package that needs more of a node is warmed up later
        with suppress(AttributeError):
            open_channel(local_node(lambda _: None), config, sensor, still)
