import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_emulator.errors import TruthGapError
from rpod_emulator.truth_buffer import TruthBuffer
from rpod_runtime import Received
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import read_pose, write_odometry
from rpod_schemas.poses import between, chained, make_pose
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.rmw.wire import Attachment
from rpod_schemas.topics import TRUTH
from rpod_schemas.types import Odometry

START_NS = 1_767_225_600_000_000_000
STEP_NS = 4_000_000
VELOCITY_M_S = np.array([0.1, -0.2, -0.5])
RATE_RAD_S = np.array([0.05, 0.3, -0.2])


def moving(stamp_ns: int) -> RigidTransform:
    """Return a pose of constant velocity and constant rate about a fixed axis."""
    since_s = (stamp_ns - START_NS) * 1e-9
    return make_pose(
        rotation=Rotation.from_rotvec(RATE_RAD_S * since_s),
        translation_m=np.array([0.0, 0.0, 7.0]) + VELOCITY_M_S * since_s,
    )


def received(stamp_ns: int, *, damage=lambda payload: payload) -> Received:
    odometry = Odometry(
        stamp_ns=stamp_ns,
        frame_id="chaser",
        child_frame_id="target",
        pose=moving(stamp_ns),
        linear_m_s=np.zeros(3),
        angular_rad_s=np.zeros(3),
    )
    payload = memoryview(damage(bytes(encode(write_odometry(odometry)))))
    return Received(TRUTH, "k", payload, Attachment(1, 0, bytes(16)), stamp_ns)


def buffer(*offsets_ns: int) -> TruthBuffer:
    made = TruthBuffer()
    for offset_ns in offsets_ns:
        made.add(received(START_NS + offset_ns))
    return made


def at_250_hz(count: int = 10) -> TruthBuffer:
    return buffer(*(number * STEP_NS for number in range(count)))


@given(st.integers(0, 9 * STEP_NS))
def test_between_samples_a_constant_twist_is_met_exactly(offset_ns):
    pose = at_250_hz().poses([START_NS + offset_ns])[0]
    expected = moving(START_NS + offset_ns)
    np.testing.assert_allclose(pose.translation, expected.translation, atol=1e-9)
    assert (pose.rotation.inv() * expected.rotation).magnitude() < 1e-9


def test_at_a_sample_the_pose_is_that_sample():
    pose = at_250_hz().poses([START_NS + 3 * STEP_NS])[0]
    np.testing.assert_array_equal(pose.translation, moving(START_NS + 3 * STEP_NS).translation)


def test_poses_of_many_stamps_are_those_of_each_one_to_the_bit_also_as_a_sensor_sees_them():
    made, mount = (
        at_250_hz(),
        make_pose(rotation=Rotation.from_rotvec([0.1, -2.0, 0.4]), translation_m=[1, 2, 3]),
    )
    stamps_ns = [START_NS + number * 1_300_000 for number in range(20)]
    for many, T_sensor_chaser in ((made.poses(stamps_ns), None), (made.poses(stamps_ns, mount), mount)):
        for stamp_ns, pose in zip(stamps_ns, many, strict=True):
            before_ns = (stamp_ns - START_NS) // STEP_NS * STEP_NS + START_NS
            ends = (
                read_pose(received(at_ns).decode().pose.pose) for at_ns in (before_ns, before_ns + STEP_NS)
            )
            alone = between(*ends, (stamp_ns - before_ns) / STEP_NS)
            seen = alone if T_sensor_chaser is None else chained(T_sensor_chaser, alone)
            np.testing.assert_array_equal(pose.as_matrix(), seen.as_matrix())


def test_a_single_lost_sample_is_bridged():
    pose = buffer(0, 2 * STEP_NS).poses([START_NS + STEP_NS])[0]
    np.testing.assert_allclose(pose.translation, moving(START_NS + STEP_NS).translation, atol=1e-9)


def test_two_samples_more_than_8_ms_apart_leave_a_gap_between_them_alone():
    gappy = buffer(0, STEP_NS, STEP_NS + 8_000_001, 2 * STEP_NS + 8_000_001)
    with pytest.raises(TruthGapError, match=r"no truth within 8\.0 ms"):
        gappy.poses([START_NS + STEP_NS + 1])
    for inside_ns in (STEP_NS // 2, STEP_NS, STEP_NS + 8_000_001, STEP_NS + 9_000_000):
        gappy.poses([START_NS + inside_ns])


@pytest.mark.parametrize("offset_ns", [-1, 9 * STEP_NS + 1])
def test_outside_the_samples_nothing_is_extrapolated(offset_ns):
    with pytest.raises(TruthGapError):
        at_250_hz().poses([START_NS + offset_ns])


def test_an_empty_buffer_knows_nothing():
    empty = TruthBuffer()
    assert (empty.first_ns, empty.last_ns) == (None, -1)
    with pytest.raises(TruthGapError):
        empty.poses([START_NS])


@pytest.mark.parametrize("offset_ns", [0, -STEP_NS])
def test_a_sample_that_is_not_newer_is_late_and_changes_nothing(offset_ns):
    made = buffer(-2 * STEP_NS, 0)
    with pytest.raises(MessageRejectedError) as rejected:
        made.add(received(START_NS + offset_ns))
    assert rejected.value.reason is Reason.LATE
    assert made.last_ns == START_NS


def test_a_stamp_far_beyond_its_arrival_does_not_make_all_that_follow_old():
    made = buffer(0)
    with pytest.raises(MessageRejectedError, match=r"truth is 5\.000 s ahead") as rejected:
        made.add(received(START_NS + 5_000_000_000), latest_ns=START_NS)
    assert rejected.value.reason is Reason.FUTURE
    made.add(received(START_NS + STEP_NS), latest_ns=START_NS + STEP_NS)
    assert made.last_ns == START_NS + STEP_NS


def test_only_the_last_seconds_are_kept():
    made = TruthBuffer(keep_s=0.02)
    for number in range(100):
        made.add(received(START_NS + number * STEP_NS))
    assert made.first_ns == made.last_ns - 20_000_000


def test_a_sample_that_cannot_be_read_is_refused_and_leaves_the_rest_as_it_was():
    made = buffer(0)
    with pytest.raises(MessageRejectedError):
        made.add(received(START_NS + STEP_NS, damage=lambda payload: payload[:40]))
    assert made.last_ns == START_NS
    made.add(received(START_NS + 2 * STEP_NS))
    made.poses([START_NS + STEP_NS])
