"""An emulated camera's messages, and what a changed exposure tells."""

import numpy as np
import pytest
from kept_messages import KeptMessages

from rpod_emulator.local_sensor import LocalSensor
from rpod_emulator.pmd import PmdChannel
from rpod_schemas.config.emulator import EmulatorConfig
from rpod_schemas.config.motion import FACING
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.schedule import DueFrame
from rpod_target import load_target

FRAME = DueFrame(1_000, "pmd", 1, 2_000)


def seen(config, *, range_m=4.0, **options):
    emulator = EmulatorConfig(target="mockup", sensors=(config,), **options)
    kept = KeptMessages()
    channel = PmdChannel(kept.node, emulator, config, load_target("mockup"))
    poses = [make_pose(rotation=FACING, translation_m=(0.0, 0.0, range_m))] * config.sub_exposures
    channel.emulate(poses, np.zeros(3), FRAME)()
    return kept


@pytest.mark.parametrize("range_m", [4.0, 1.0])
def test_an_exposure_that_changes_is_announced_before_its_frame(range_m):
    config = PmdConfig(exposure="automatic")
    kept = seen(config, range_m=range_m)
    times_s = [message.integration_time_s for message in kept.of("pmd/info")]
    if range_m == 4.0:
        assert times_s == [config.integration_time_s]
    else:
        assert times_s[0] == config.integration_time_s > times_s[1] > 0.0
        names = kept.names
        assert names.index("pmd/depth/image_raw") > len(names) - names[::-1].index("pmd/info") - 1


def test_a_frame_without_a_bus_has_the_info_of_its_own_exposure():
    config = PmdConfig(exposure="automatic")
    local = LocalSensor(EmulatorConfig(target="mockup", sensors=(config,)), config, load_target("mockup"))
    times_s = []
    for range_m in (4.0, 1.0):
        pose = make_pose(rotation=FACING, translation_m=(0.0, 0.0, range_m))
        frame = local.frame([pose] * config.sub_exposures, np.zeros(3), FRAME)
        times_s.append(frame.info.integration_time_s)
    assert times_s[0] == config.integration_time_s > times_s[1] > 0.0


def test_raw_samples_are_one_message_a_frequency():
    kept = seen(PmdConfig(profile="dual"), publish_samples=True)
    first, second = kept.of("pmd/phase/image_raw")
    assert first.encoding == second.encoding == "16UC4"
    assert bytes(first.data) != bytes(second.data)
