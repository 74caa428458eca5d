"""Frames without a bus: they load all code before the emulator joins it, as a process in reserve must."""

import os
from contextlib import suppress
from typing import Any, cast

from rpod_emulator.channels import open_channel
from rpod_emulator.joints import MovingJoints
from rpod_runtime import Node
from rpod_runtime.clock import WallClock
from rpod_runtime.health import HealthBook
from rpod_runtime.process.reserve import RESERVE
from rpod_schemas.config.emulator import EmulatorConfig
from rpod_schemas.topics import Topic
from rpod_target import Target


class _Unheard:
    """A publisher whose messages nobody gets."""

    def publish(self, message: Any) -> None:
        """Do nothing."""

    def put(self, payload: bytes | bytearray) -> None:
        """Do nothing."""


class _OffBus:
    """Node for a sensor's publisher, without a bus."""

    def __init__(self) -> None:
        self.clock, self.health = WallClock(), HealthBook("rehearsal")

    def publisher(self, topic: Topic) -> _Unheard:  # noqa: ARG002 - as of a node
        """Return a publisher whose messages nobody gets."""
        return _Unheard()


def rehearse(config: EmulatorConfig, target: Target) -> None:
    """Make one frame of each sensor, if this process is in reserve; others do so when they open the sensors.

    Raises:
        ConfigurationError: a sensor cannot be emulated.
    """
    if not os.environ.get(RESERVE):
        return
    still = MovingJoints(config, target).at(0.0)
    for sensor in config.sensors:
        with suppress(
            AttributeError
        ):  # a sensor kind of another package that needs more of a node is warmed up later
            open_channel(cast(Node, _OffBus()), config, sensor, still)
