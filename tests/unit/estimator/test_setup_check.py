"""A sensor that is set up otherwise while it is tracked: refused, with what changed and what to do."""

import numpy as np
import pytest

from rpod_estimator.setup_check import Setup, SetupCheck
from rpod_runtime.delivery.holders import Peer
from rpod_runtime.errors import ExtrinsicsError
from rpod_runtime.sensor_data.extrinsics import Extrinsics
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.poses import make_pose
from rpod_schemas.topics import CHASER
from rpod_schemas.types import LidarInfo

DRIVER = Peer(b"d" * 16, "d")


def pattern(step_deg: float) -> LidarInfo:
    angles = np.radians(np.arange(-5.0, 5.0, step_deg))
    return LidarInfo(azimuth_rad=angles, elevation_rad=angles, scan_time_s=0.5, sigma_range_m=0.02)


def test_another_scan_pattern_is_not_used_while_tracked_until_a_reset():
    check, mount = SetupCheck(), make_pose()
    check.check("lidar", Setup(mount, pattern(0.5)), source=DRIVER, pinned=True)
    other = Setup(mount, pattern(0.25))
    with pytest.raises(
        MessageRejectedError,
        match=r"_rad of the sensor's info has changed from 20 values to 40 values .*`reset`",
    ):
        check.check("lidar", other, source=DRIVER, pinned=True)
    assert check.info("lidar", other.info).azimuth_rad.size == 20
    check.forget()
    check.check("lidar", other, source=DRIVER, pinned=True)


@pytest.mark.parametrize("learned", [False, True])
def test_a_pattern_that_is_stated_by_other_fields_is_another_one(learned: bool):
    check, mount, plain = SetupCheck(), make_pose(), pattern(0.5)
    rows = plain.model_copy(update={"row_azimuth_rad": np.full(plain.elevation_rad.size, 0.01)})
    before, after = (plain, rows) if learned else (rows, plain)
    check.check("lidar", Setup(mount, before), source=DRIVER, pinned=True)
    told = "none to 20 values" if learned else "20 values to none"
    with pytest.raises(
        MessageRejectedError, match=f"row_azimuth_rad of the sensor's info has changed from {told}"
    ):
        check.check("lidar", Setup(mount, after), source=DRIVER, pinned=True)


def test_mounts_that_two_sources_give_differently_are_told_with_their_distance():
    configured = make_pose(translation_m=(0.3, 0.0, 0.0))
    mounts = Extrinsics({"pmd": configured})
    mounts.set(CHASER, "pmd_optical", make_pose(translation_m=(0.3, 0.04, 0.03)))
    with pytest.raises(ExtrinsicsError, match=r"differ by 0\.050 m and 0\.00 deg: correct one of them"):
        mounts.mount("pmd", "pmd_optical")
