"""Rate and age of what arrives, and the pace of a stream of reduced rate."""

import numpy as np
import pytest
from kept_messages import KeptMessages

from rpod_runtime.delivery.flow import Flow
from rpod_runtime.sensor_data.codecs import decompressed
from rpod_runtime.sensor_data.reduced_rate import Pace, ReducedRateCamera
from rpod_schemas.config.pmd.reduced_rate import ReducedRateConfig
from rpod_schemas.messages import read_camera, read_image, read_stamp
from rpod_schemas.types import Camera, PmdFrame

SECOND_NS = 1_000_000_000


def test_the_rate_is_that_since_the_last_look_and_the_age_the_greatest():
    flow = Flow()
    flow.take(10.0)
    for size, age_s in ((1_000_000, 0.1), (250_000, 0.4), (0, 0.2)):
        flow.add("pmd/depth/image_raw", size, age_s)
    assert flow.take(12.0) == pytest.approx(
        {"link_mbit_s/pmd/depth/image_raw": 5.0, "link_age_s/pmd/depth/image_raw": 0.4}
    )
    assert flow.take(13.0) == {"link_mbit_s/pmd/depth/image_raw": 0.0}


def test_the_pace_leaves_each_frame_its_time_on_the_link_and_begins_anew_when_stamps_go_back():
    pace = Pace(8.0)
    assert pace.allows(5 * SECOND_NS)
    pace.sent(5 * SECOND_NS, 500_000)  # half a second of 8 Mbit/s
    assert [pace.allows(round(stamp_s * SECOND_NS)) for stamp_s in (5.4, 5.5, 4.0)] == [False, True, True]


def frames(count):
    camera = Camera(width=64, height=48, fx=60.0, fy=60.0, cx=31.5, cy=23.5)
    random = np.random.default_rng(3)
    for number in range(count):
        depth_m = random.uniform(3.0, 5.0, (48, 64)).astype(np.float32)
        amplitude = random.integers(0, 4000, (48, 64), np.uint16)
        yield PmdFrame(
            stamp_ns=number * SECOND_NS // 15,
            frame_id="",
            depth_m=depth_m,
            amplitude=amplitude,
            camera=camera,
        )


@pytest.mark.parametrize("codec", ["shuffle zstd", "none"])
def test_only_whole_frames_are_sent_within_the_bandwidth_and_to_the_bit(codec):
    kept, given = KeptMessages(), list(frames(150))
    reduced = ReducedRateCamera(kept.node, "pmd", ReducedRateConfig(mbit_s=0.6, codec=codec))
    for frame in given:
        reduced.publish(frame)
    form = "image_raw" if codec == "none" else "compressed"
    camera, depth, amplitude = (
        kept.of(f"slow/pmd/{part}") for part in ("camera_info", f"depth/{form}", f"amplitude/{form}")
    )
    stamps = [[read_stamp(message.header) for message in part] for part in (camera, depth, amplitude)]
    assert stamps[0] == stamps[1] == stamps[2]
    sizes = sum(message.data.nbytes for message in (*depth, *amplitude))
    assert 0.4 < 8e-6 * sizes / 10.0 <= 0.6 + 8e-6 * sizes / len(depth) / 10.0
    plain = depth if codec == "none" else [decompressed(message) for message in depth]
    by_stamp = {frame.stamp_ns: frame for frame in given}
    assert all(np.array_equal(read_image(each), by_stamp[read_stamp(each.header)].depth_m) for each in plain)
    assert read_camera(camera[0]).fx == 60.0
