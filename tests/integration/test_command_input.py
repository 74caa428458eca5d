"""The chaser's commanded acceleration on a real bus, as the estimator hears it."""

from time import monotonic

import numpy as np
import pytest
from live_bus import TIMEOUT_S

from rpod_estimator.inputs.command import CommandInput
from rpod_pose.navigation.dynamics.command_track import CommandTrack
from rpod_schemas.config.estimator import EstimatorConfig, PmdInput
from rpod_schemas.messages import write_command
from rpod_schemas.topics import CHASER, COMMAND
from rpod_schemas.types import Command

STAMP_NS, PERIOD_NS = 10**18, 100_000_000
ALONG = np.array([0.0, 0.01, 0.0])


def an_input(bus, track):
    config = {"target": "mockup", "bus": bus.config, "sensors": [PmdInput()], "dynamics": {"command": {}}}
    node = bus.node("estimator")
    return node, CommandInput(node, EstimatorConfig.model_validate(config), track)


def publish(bus, *messages):
    publisher = bus.node("guidance").publisher(COMMAND)
    for message in messages:
        publisher.publish(message)


def a_message(number):
    stamp_ns = STAMP_NS + number * PERIOD_NS
    return write_command(Command(stamp_ns=stamp_ns, frame_id=CHASER, acceleration_m_s2=ALONG))


def test_commands_are_waited_for_up_to_a_frame_and_their_end_is_told(bus):
    track, last_ns, ends_s = CommandTrack(), STAMP_NS + 19 * PERIOD_NS, monotonic() + TIMEOUT_S
    node, commands = an_input(bus, track)
    publish(bus, *map(a_message, range(20)))
    while not track.covers(last_ns) and monotonic() < ends_s:
        commands.take_until(last_ns)
    assert track.is_known(last_ns)
    assert "command" not in node.health.diagnostic(0).values
    commands.take_until(last_ns + 2 * 10**9)
    assert "the chaser's acceleration is unknown" in node.health.diagnostic(0).values["command"]
    assert node.health.counters()["command/unknown"] > 0


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda message: setattr(message.accel.accel.linear, "x", 5000.0), "malformed"),
        (lambda message: setattr(message.accel.accel.linear, "x", float("nan")), "not_finite"),
        (lambda message: setattr(message.header.stamp, "sec", 2_000_000_000), "future"),
        (lambda message: setattr(message.header.stamp, "sec", 10), "duplicate"),
    ],
    ids=["too strong", "not finite", "ahead of the clock", "late"],
)
def test_a_command_that_cannot_be_used_is_rejected_and_told(bus, change, reason):
    track, ends_s = CommandTrack(), monotonic() + TIMEOUT_S
    node, commands = an_input(bus, track)
    wrong = a_message(2)
    change(wrong)
    publish(bus, a_message(0), a_message(1), wrong, a_message(3))
    name = f"rejected/{COMMAND.name}/{reason}"
    while not node.health.counters().get(name, 0) and monotonic() < ends_s:
        commands.take_until(STAMP_NS + 3 * PERIOD_NS)
    assert node.health.counters()[name] == 1
