from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from rpod_schemas import messages
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw.cdr import decode, encode, peek_stamp
from rpod_schemas.types import (
    Camera,
    Diagnostic,
    EstimatorStatus,
    Health,
    Hypothesis,
    Joints,
    Mode,
    Odometry,
    Source,
)

FINITE = st.floats(-1e3, 1e3, allow_subnormal=False)
VECTORS = hnp.arrays(np.float64, 3, elements=FINITE)
STAMPS = st.integers(0, 2**31 * 1_000_000_000 - 1)
ANGLES = hnp.arrays(np.float64, 3, elements=st.floats(-3.0, 3.0))


def through_the_wire(message):
    return decode(memoryview(bytes(encode(message))), message.__msgtype__)


@given(STAMPS, VECTORS, ANGLES, VECTORS)
def test_odometry_survives_the_wire(stamp_ns, position, rotvec, twist):
    pose = make_pose(rotation=Rotation.from_rotvec(rotvec), translation_m=position)
    covariance = np.diag(np.arange(6.0))
    sent = Odometry(
        stamp_ns=stamp_ns,
        frame_id="chaser",
        child_frame_id="target",
        pose=pose,
        linear_m_s=twist,
        angular_rad_s=-twist,
        pose_covariance=covariance,
    )
    got = messages.read_odometry(through_the_wire(messages.write_odometry(sent)))
    assert got.stamp_ns == stamp_ns
    np.testing.assert_array_equal(got.pose.translation, position)
    assert (got.pose.rotation.inv() * pose.rotation).magnitude() < 1e-7
    np.testing.assert_array_equal(got.linear_m_s, twist)
    np.testing.assert_array_equal(got.angular_rad_s, -twist)
    np.testing.assert_array_equal(got.pose_covariance, covariance)


@given(hnp.arrays(np.float32, (7, 5), elements=st.floats(0.5, 10, width=32)))
def test_depth_survives_the_wire_as_a_view(depth_m):
    depth_m[0, 0] = np.nan
    payload = memoryview(bytes(encode(messages.write_image(1, "pmd_optical", depth_m, "32FC1"))))
    got = messages.read_depth(decode(payload, "sensor_msgs/msg/Image"))
    np.testing.assert_array_equal(got, depth_m)
    assert not got.flags.owndata
    assert np.shares_memory(got, np.frombuffer(payload, np.uint8))


def test_depth_in_millimetres_has_no_depth_at_zero_and_at_the_largest_value():
    image = np.array([[0, 1500], [2500, 65535]], np.uint16)
    got = messages.read_depth(through_the_wire(messages.write_image(1, "c", image, "16UC1")))
    np.testing.assert_allclose(got, [[np.nan, 1.5], [2.5, np.nan]], rtol=1e-6)


@pytest.mark.parametrize(("dtype", "encoding"), [("u1", "mono8"), ("<u2", "mono16"), ("<f4", "32FC1")])
def test_amplitude_comes_in_three_encodings(dtype, encoding):
    image = np.arange(12).reshape(3, 4).astype(dtype)
    got = messages.read_amplitude(through_the_wire(messages.write_image(1, "c", image, encoding)))
    np.testing.assert_array_equal(got, image)


def test_big_endian_pixels_are_read_as_they_are_meant():
    message = messages.write_image(1, "c", np.array([[1, 256]], ">u2"), "mono16")
    message.is_bigendian = 1
    np.testing.assert_array_equal(messages.read_amplitude(through_the_wire(message)), [[1, 256]])


def test_an_amplitude_that_is_not_measured_is_dark():
    image = np.array([[np.nan, 2.5]], np.float32)
    got = messages.read_amplitude(through_the_wire(messages.write_image(1, "c", image, "32FC1")))
    np.testing.assert_array_equal(got, [[0.0, 2.5]])


def image_message(**changes):
    message = messages.write_image(1, "c", np.ones((4, 6), np.float32), "32FC1")
    for name, value in changes.items():
        setattr(message, name, value)
    return message


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"encoding": "rgb8"}, Reason.WRONG_TYPE),
        ({"encoding": "mono8"}, Reason.WRONG_TYPE),
        ({"width": 7}, Reason.WRONG_SIZE),
        ({"height": 5}, Reason.WRONG_SIZE),
        ({"height": 0}, Reason.WRONG_SIZE),
        ({"step": 3}, Reason.WRONG_SIZE),
        ({"data": np.zeros(10, np.uint8)}, Reason.WRONG_SIZE),
        ({"data": np.full(24, np.nan, np.float32).view(np.uint8)}, Reason.NOT_FINITE),
    ],
)
def test_a_wrong_depth_image_is_rejected_with_its_reason(changes, reason):
    with pytest.raises(MessageRejectedError) as rejected:
        messages.read_depth(through_the_wire(image_message(**changes)))
    assert rejected.value.reason is reason


def test_a_camera_survives_the_wire():
    camera = Camera(
        width=352,
        height=287,
        fx=682.75,
        fy=691.42,
        cx=175.5,
        cy=143.0,
        distortion=np.array([0.1, -0.02, 0.001, 0, 0]),
    )
    got = messages.read_camera(through_the_wire(messages.write_camera(1, "c", camera)))
    np.testing.assert_array_equal(got.K, camera.K)
    np.testing.assert_array_equal(got.distortion, camera.distortion)


def test_binning_and_region_of_a_camera_are_those_of_its_images():
    message = messages.write_camera(1, "c", Camera(width=640, height=480, fx=600, fy=602, cx=319.5, cy=239.5))
    message.binning_x = message.binning_y = 2
    roi = message.roi
    roi.x_offset, roi.y_offset, roi.width, roi.height = 100, 40, 400, 320
    got = messages.read_camera(through_the_wire(message))
    assert (got.width, got.height, got.fx, got.fy) == (200, 160, 300.0, 301.0)
    # the principal point lies between pixels 219 and 220 of the region: in the middle of pixel 109.5
    assert (got.cx, got.cy) == (109.5, 99.5)


def test_the_lens_of_a_wide_camera_survives_the_wire():
    lens = np.array([5.26, 3.55, 4e-5, -9e-5, 0.18, 5.59, 5.41, 0.95])
    camera = Camera(width=640, height=576, fx=504, fy=504, cx=320, cy=330, distortion=lens)
    got = messages.read_camera(through_the_wire(messages.write_camera(1, "c", camera)))
    np.testing.assert_array_equal(got.distortion, lens)


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("distortion_model", "double_sphere", Reason.WRONG_TYPE),
        ("k", np.full(9, np.nan), Reason.NOT_FINITE),
        ("k", np.zeros(9), Reason.MALFORMED),
        ("k", np.array([5.0, 0, 0, 0, 5.0, 0, 1.0, 1.0, 1.0]), Reason.MALFORMED),
        ("d", np.ones(8), Reason.WRONG_SIZE),
        ("width", 0, Reason.MALFORMED),
    ],
)
def test_a_wrong_camera_is_rejected_with_its_reason(name, value, reason):
    message = messages.write_camera(1, "c", Camera(width=4, height=3, fx=1, fy=1, cx=1, cy=1))
    setattr(message, name, value)
    with pytest.raises(MessageRejectedError) as rejected:
        messages.read_camera(through_the_wire(message))
    assert rejected.value.reason is reason


@pytest.mark.parametrize("shape", [(3, 4), (12,)])
def test_points_survive_the_wire_organised_or_not(shape):
    fields = {
        name: np.random.default_rng(1).random(shape, np.float32) for name in ("x", "y", "z", "intensity", "t")
    }
    got = messages.read_points(through_the_wire(messages.write_points(1, "lidar", fields)))
    for name, values in fields.items():
        np.testing.assert_array_equal(got[name], values)


def points_message():
    return messages.write_points(1, "lidar", {name: np.ones((3, 4), np.float32) for name in ("x", "y", "z")})


def test_points_without_z_are_rejected():
    message = points_message()
    message.fields = message.fields[:2]
    with pytest.raises(MessageRejectedError, match="z are missing"):
        messages.read_points(through_the_wire(message))


def test_points_in_too_few_bytes_are_rejected():
    message = points_message()
    message.data = message.data[:-1]
    with pytest.raises(MessageRejectedError) as rejected:
        messages.read_points(through_the_wire(message))
    assert rejected.value.reason is Reason.WRONG_SIZE


def test_points_of_an_unknown_type_are_rejected():
    message = points_message()
    message.fields[0].datatype = 9
    with pytest.raises(MessageRejectedError) as rejected:
        messages.read_points(through_the_wire(message))
    assert rejected.value.reason is Reason.WRONG_TYPE


def test_a_status_survives_the_wire():
    sent = EstimatorStatus(
        stamp_ns=5,
        frame_id="chaser",
        mode=Mode.TRACKING,
        source=Source.PMD_DEPTH,
        sensor="pmd",
        accepted=True,
        cost_m2=1e-4,
        nis=5.5,
        inliers=900,
        inlier_share=0.9,
        processing_s=0.01,
        ambiguous=True,
        hypotheses=(Hypothesis(pose=make_pose(), weight=0.75), Hypothesis(pose=make_pose(), weight=0.25)),
    )
    got = messages.read_status(through_the_wire(messages.write_status(sent)))
    assert [item.weight for item in got.hypotheses] == [0.75, 0.25]
    skip = {"hypotheses", "inlier_share"}
    assert got.model_dump(exclude=skip) == sent.model_dump(exclude=skip)


def test_diagnostics_survive_the_wire():
    sent = Diagnostic(
        stamp_ns=7, name="emulator", level=Health.WARN, message="slow", values={"frames/pmd": "3"}
    )
    assert messages.read_diagnostics(through_the_wire(messages.write_diagnostics([sent]))) == [sent]


def test_transforms_survive_the_wire():
    pose = make_pose(rotation=Rotation.from_rotvec([0, 0, 1]), translation_m=[1, 2, 3])
    (got,) = messages.read_transforms(
        through_the_wire(messages.write_transforms(9, [("chaser", "pmd_optical", pose)]))
    )
    assert got[:3] == (9, "chaser", "pmd_optical")
    np.testing.assert_allclose(got[3].as_matrix(), pose.as_matrix(), atol=1e-15)


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 0), (0, 0, 0, 2), (np.nan, 0, 0, 1)])
def test_a_pose_whose_quaternion_has_no_unit_norm_is_rejected(quaternion):
    pose = messages.write_pose(make_pose())
    pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w = map(float, quaternion)
    with pytest.raises(MessageRejectedError):
        messages.read_pose(pose)


@pytest.mark.parametrize("length", [0, 3, 11, 40, 200])
def test_truncated_bytes_are_malformed(length):
    payload = bytes(encode(image_message()))[: min(length, 90)]
    with pytest.raises(MessageRejectedError) as rejected:
        messages.read_depth(decode(payload, "sensor_msgs/msg/Image"))
    assert rejected.value.reason in (Reason.MALFORMED, Reason.WRONG_SIZE)


@given(st.binary(max_size=300))
def test_random_bytes_never_do_worse_than_a_rejection(payload):
    with suppress(MessageRejectedError):
        messages.read_odometry(decode(b"\x00\x01\x00\x00" + payload, "nav_msgs/msg/Odometry"))


@given(STAMPS)
def test_the_stamp_is_read_without_decoding(stamp_ns):
    payload = encode(messages.write_vector_stamped(stamp_ns, "chaser", np.zeros(3)))
    assert peek_stamp(payload) == stamp_ns


def test_angles_of_joints_survive_the_wire_and_incomplete_ones_are_refused():
    sent = Joints(stamp_ns=7, angle_rad={"a": 0.5, "b": -1.0}, rate_rad_s={"a": 0.0, "b": 0.01})
    message = messages.write_joints(sent)
    assert messages.read_joints(through_the_wire(message)) == sent
    message.velocity = np.zeros(0)
    assert messages.read_joints(message).rate_rad_s == {"a": 0.0, "b": 0.0}
    message.position = np.array([0.5, np.nan])
    with pytest.raises(MessageRejectedError, match="position or velocity"):
        messages.read_joints(message)
    message.position = np.zeros(3)
    with pytest.raises(MessageRejectedError, match="2 names, 3 positions"):
        messages.read_joints(message)
