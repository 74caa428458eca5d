"""What the estimator publishes of a result."""

from types import SimpleNamespace

import numpy as np
import pytest
from kept_messages import KeptMessages
from scipy.spatial.transform import Rotation

from rpod_estimator.outputs import Outputs
from rpod_pose.belief import PixelMarks
from rpod_pose.navigation.state import Output, RefusedPixels
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import read_image, read_integrity, read_pose, write_status
from rpod_schemas.poses import covariance_at, make_pose
from rpod_schemas.types import EstimateValidity, EstimatorStatus, Integrity, IntegrityState, Mode, Odometry

POSE = make_pose(rotation=Rotation.from_rotvec([0.3, -0.4, 1.0]), translation_m=(0.0, 0.5, 8.0))
VALID = EstimateValidity(stamp_ns=1, frame_id="chaser", valid=True, age_s=0.05, reason="")
ALERT = Integrity(
    stamp_ns=1,
    frame_id="chaser",
    state=IntegrityState.ALERT,
    reason="pmd: frozen",
    risk=1e-6,
    evidence={"a_s": 0.5},
)
GRAPPLE = make_pose(rotation=Rotation.from_rotvec([0.0, 1.0, 0.0]), translation_m=(1.5, 0.0, -0.5))


def test_estimate_and_frames_of_the_target_are_published_before_integrity_and_status_are_known():
    kept = KeptMessages()
    covariance = np.diag([1e-4, 2e-4, 3e-4, 1e-6, 2e-6, 3e-6])
    odometry = Odometry(
        stamp_ns=1,
        frame_id="chaser",
        child_frame_id="target_estimate",
        pose=POSE,
        linear_m_s=np.zeros(3),
        angular_rad_s=np.zeros(3),
        pose_covariance=covariance,
    )
    status = EstimatorStatus(stamp_ns=1, frame_id="chaser", mode=Mode.TRACKING, sensor="pmd")
    target = SimpleNamespace(frames={"grapple": GRAPPLE}, joints=())
    refused = RefusedPixels("pmd_optical", PixelMarks(np.eye(3, dtype=np.bool_), 4))
    outputs = Outputs(kept.node, "second", target)
    outputs.publish_estimate(Output(status, odometry, refused), VALID)
    assert {
        "second/odometry",
        "second/pose",
        "second/frames/grapple",
        "second/validity",
    } <= set(kept.names)
    assert not {"second/integrity", "second/status"} & set(kept.names)
    outputs.publish_judgement(status, ALERT)
    (marks,) = kept.of("second/contradiction")
    assert (marks.header.frame_id, marks.header.stamp.nanosec) == ("pmd_optical", 1)
    np.testing.assert_array_equal(read_image(marks), 255 * np.eye(3))
    (message,) = kept.of("second/frames/grapple")
    assert message.header.frame_id == "chaser"
    np.testing.assert_allclose(read_pose(message.pose.pose).as_matrix(), (POSE * GRAPPLE).as_matrix())
    arm_m = POSE.rotation.apply(GRAPPLE.translation)
    expected = covariance_at(covariance, arm_m)
    np.testing.assert_allclose(message.pose.covariance.reshape(6, 6), expected)
    assert expected[0, 0] > covariance[0, 0]
    assert kept.names[-3:] == ["second/validity", "second/integrity", "second/status"]
    (integrity,) = kept.of("second/integrity")
    told = read_integrity(integrity)
    assert (told.state, told.reason, told.evidence) == (IntegrityState.ALERT, "pmd: frozen", {"a_s": 0.5})
    assert np.isnan(told.position_level_m)
    (validity,) = kept.of("second/validity")
    assert (validity.valid, validity.age_s) == (True, 0.05)


def test_a_status_beyond_the_bounds_is_not_sent_and_told_with_the_fields_name():
    kept = KeptMessages()
    status = EstimatorStatus(stamp_ns=1, frame_id="chaser", mode=Mode.ACQUIRING, sensor="pmd", cost_m2=-1.0)
    with pytest.raises(MessageRejectedError, match="cost_m2 is -1, needs 0 or more"):
        write_status(status)
    Outputs(kept.node, "estimate", SimpleNamespace(frames={}, joints=())).publish_judgement(status, ALERT)
    (sent,) = kept.of("estimate/status")
    assert (sent.sensor, sent.accepted) == ("pmd", False)
    assert "cost_m2 is -1" in sent.reason
    assert "cost_m2 is -1" in kept.node.health.rejection("estimate/status")


def test_the_transform_is_sent_25_times_a_second_and_at_once_after_a_clock_was_set_back():
    kept = KeptMessages()
    outputs = Outputs(kept.node, "estimate", SimpleNamespace(frames={}, joints=()))
    sent = []
    for stamp_ns in (4_000_000_000, 4_010_000_000, 4_050_000_000, 1_000_000_000, 1_010_000_000):
        status = EstimatorStatus(stamp_ns=stamp_ns, frame_id="chaser", mode=Mode.TRACKING, sensor="pmd")
        odometry = Odometry(
            stamp_ns=stamp_ns, frame_id="chaser", child_frame_id="target_estimate", pose=POSE,
            linear_m_s=np.zeros(3), angular_rad_s=np.zeros(3),
        )  # fmt: skip
        outputs.publish_estimate(Output(status, odometry), VALID)
        sent.append(len(kept.of("tf")))
    assert sent == [1, 1, 2, 3, 3]
