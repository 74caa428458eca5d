"""What becomes of a track while its sensor's frames hold no measurement."""

import numpy as np
import pytest
from navigator_rig import MOUNT, SECOND_NS, START_S, good, tracking

from rpod_estimator.estimator import Estimator
from rpod_estimator.frame_reader import Arrived
from rpod_pose.measurement import Measurement
from rpod_pose.navigation.dynamics.imu_track import ImuTrack
from rpod_pose.surroundings.bodies import FrameTrack
from rpod_schemas.config.estimator import EstimatorConfig, PmdInput
from rpod_schemas.control import ResetRequest
from rpod_schemas.errors import Reason
from rpod_schemas.poses import make_pose
from rpod_schemas.types import ImuReading, Mode
from rpod_target import load_target


def modes_while(refused: Reason) -> list[Mode]:
    """Return the modes of an estimator that tracks, while each frame is refused for a reason."""
    config = EstimatorConfig(target="mockup", sensors=(PmdInput(),))
    estimator, made = Estimator(config, load_target("mockup")), tracking()
    estimator._navigator, estimator._state = made.navigator, made.state
    modes = []
    for number in range(1, 40):
        stamp_ns = round((START_S + 1.0 + number / 10.0) * SECOND_NS)
        arrived = Arrived("pmd", stamp_ns, 0.0, None, f"{refused}: no finite pixel", refused)
        modes.append(estimator.process(arrived).status.mode)
    return modes


@pytest.mark.parametrize(
    "refused", [Reason.NOT_FINITE, Reason.EMPTY, Reason.FROZEN, Reason.OTHER_CAMERA, Reason.OTHER_SETUP]
)
def test_a_track_coasts_and_is_lost_while_no_frame_holds_a_measurement(refused):
    modes = modes_while(refused)
    assert Mode.TRACKING not in modes[3:]
    assert Mode.COASTING in modes
    assert modes[-1] == Mode.LOST


@pytest.mark.parametrize("refused", [Reason.LATE, Reason.FUTURE])
def test_a_frame_with_a_wrong_stamp_tells_no_time(refused):
    assert set(modes_while(refused)) == {Mode.TRACKING}


@pytest.mark.parametrize("back_s", [5.0, 80.0])
def test_after_a_clock_was_set_back_and_a_reset_estimates_have_the_stamps_of_the_frames(back_s):
    config = EstimatorConfig(target="mockup", sensors=(PmdInput(),))
    estimator, made = Estimator(config, load_target("mockup")), tracking()
    estimator._navigator, estimator._state = made.navigator, made.state
    estimator.request_reset(ResetRequest())
    shown_ns = []
    for number in range(10):
        view = good(START_S + 1.0 - back_s + number / 10.0)
        output = estimator.process(Arrived("pmd", view.stamp_ns, 0.0, Measurement("pmd", view, MOUNT)))
        shown_ns.append((view.stamp_ns, None if output.odometry is None else output.odometry.stamp_ns))
    assert estimator.mode == Mode.TRACKING
    assert all(shown in (None, stamp) for stamp, shown in shown_ns)
    assert shown_ns[-1][1] is not None


def test_readings_of_a_clock_that_was_set_back_count_again_once_the_others_are_forgotten():
    track, imu = FrameTrack(), ImuTrack()
    early, late = (
        ImuReading(stamp_ns=stamp_ns, frame_id="chaser", rate_rad_s=np.zeros(3))
        for stamp_ns in (SECOND_NS, 9 * SECOND_NS)
    )
    assert track.take(late.stamp_ns, make_pose())
    assert imu.take(late)
    assert not track.take(early.stamp_ns, make_pose())
    assert not imu.take(early)
    track.forget()
    imu.forget()
    assert track.take(early.stamp_ns, make_pose())
    assert imu.take(early)
