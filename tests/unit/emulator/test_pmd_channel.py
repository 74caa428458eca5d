"""An emulated camera's messages, and what a changed exposure tells."""

import numpy as np
import pytest

from rpod_emulator.pmd import PmdChannel
from rpod_runtime.clock import WallClock
from rpod_schemas.config.emulator import EmulatorConfig
from rpod_schemas.config.motion import FACING
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.schedule import DueFrame
from rpod_target import load_target

FRAME = DueFrame(1_000, "pmd", 1, 2_000)


class FakeNode:
    """Keeps what is published, encoded as late as it was on the bus."""

    def __init__(self):
        self.clock, self.messages = WallClock(), []

    def publisher(self, topic):
        return FakePublisher(topic.name, self.messages)

    def of(self, name):
        return [message for topic, message in self.messages if topic == name]


class FakePublisher:
    def __init__(self, name, messages):
        self._name, self._messages = name, messages

    def publish(self, message):
        self._messages.append((self._name, message))


def seen(node, config, *, range_m=4.0, **options):
    emulator = EmulatorConfig(target="mockup", sensors=(config,), **options)
    channel = PmdChannel(node, emulator, config, load_target("mockup"))
    poses = [make_pose(rotation=FACING, translation_m=(0.0, 0.0, range_m))] * config.sub_exposures
    channel.emulate(poses, np.zeros(3), FRAME)()


@pytest.mark.parametrize("range_m", [4.0, 1.0])
def test_an_exposure_that_changes_is_announced_before_its_frame(range_m):
    node, config = FakeNode(), PmdConfig(exposure="automatic")
    seen(node, config, range_m=range_m)
    times_s = [message.integration_time_s for message in node.of("pmd/info")]
    if range_m == 4.0:
        assert times_s == [config.integration_time_s]
    else:
        assert times_s[0] == config.integration_time_s > times_s[1] > 0.0
        topics = [topic for topic, _ in node.messages]
        assert topics.index("pmd/depth/image_raw") > len(topics) - topics[::-1].index("pmd/info") - 1


def test_raw_samples_are_one_message_a_frequency():
    node = FakeNode()
    seen(node, PmdConfig(profile="dual"), publish_samples=True)
    first, second = node.of("pmd/phase/image_raw")
    assert first.encoding == second.encoding == "16UC4"
    assert bytes(first.data) != bytes(second.data)
