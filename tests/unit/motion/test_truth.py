"""The truth's messages, through a node without a bus."""

import numpy as np
import pytest
from kept_messages import KeptMessages

from rpod_motion.motion import Motion, build_motion
from rpod_motion.truth import TruthPublisher
from rpod_motion.truth_error import TruthError
from rpod_schemas.config.motion import BodyMotionConfig, MotionConfig, TruthErrorConfig
from rpod_schemas.messages import read_odometry, read_transforms
from rpod_schemas.poses import make_pose
from rpod_schemas.topics import BODY, REFERENCE, SUN, TF, TRUTH

EPOCH_NS = 1_767_225_600_000_000_000
STEP_NS = 4_000_000


@pytest.fixture
def motion() -> Motion:
    config = MotionConfig.model_validate(
        {
            "trajectory": {"kind": "approach", "start_m": [0, 0, 7], "end_m": [0, 0, 2]},
            "attitude": {"kind": "spin", "axis": [1, 0, 0], "rate_deg_s": 5},
        }
    )
    return build_motion(config, centre_of_mass_m=np.zeros(3), inertia_kg_m2=np.eye(3), duration_s=1.0)


def test_every_tick_has_its_own_truth_in_order(motion):
    kept = KeptMessages()
    truth = TruthPublisher(kept.node, motion, epoch_ns=EPOCH_NS, rate_hz=250.0)
    for tick in range(-3, 30):
        truth.publish(tick)
    sent = [read_odometry(message) for message in kept.of(TRUTH.name)]
    assert [odometry.stamp_ns for odometry in sent] == [EPOCH_NS + tick * STEP_NS for tick in range(-3, 30)]
    for tick, odometry in zip(range(-3, 30), sent, strict=True):
        expected = motion.state(tick / 250.0).T_chaser_target.as_matrix()
        np.testing.assert_allclose(odometry.pose.as_matrix(), expected, atol=1e-14)
    stamps_ns = [stamp_ns for message in kept.of(TF.name) for stamp_ns, *_ in read_transforms(message)]
    assert stamps_ns == [EPOCH_NS + tick * STEP_NS for tick in (0, 10, 20)]


def test_the_sun_is_known_before_any_truth(motion):
    kept = KeptMessages()
    TruthPublisher(kept.node, motion, epoch_ns=EPOCH_NS, rate_hz=250.0).publish(-25)
    assert kept.names[:2] == [SUN.name, TRUTH.name]


def test_a_slow_truth_is_never_made_beyond_the_motion(motion):
    truth = TruthPublisher(KeptMessages().node, motion, epoch_ns=EPOCH_NS, rate_hz=2.0)
    for tick in range(3):
        truth.publish(tick)


def test_the_truth_states_its_error_and_the_reference_is_exact(motion):
    error = TruthError(TruthErrorConfig(), seed=1, rate_hz=250.0)
    kept = KeptMessages()
    publisher = TruthPublisher(kept.node, motion, epoch_ns=EPOCH_NS, rate_hz=250.0, error=error)
    for tick in range(20):
        publisher.publish(tick)
    truth, reference = (
        [read_odometry(message) for message in kept.of(topic.name)] for topic in (TRUTH, REFERENCE)
    )
    for tick, (known, exact) in enumerate(zip(truth, reference, strict=True)):
        expected = motion.state(tick / 250.0).T_chaser_target
        np.testing.assert_allclose(exact.pose.as_matrix(), expected.as_matrix(), atol=1e-14)
        assert not exact.pose_covariance.any()
        np.testing.assert_allclose(known.pose_covariance, error.covariance)
        off_m = np.linalg.norm(known.pose.translation - exact.pose.translation)
        assert 0.0 < off_m < 5.0 * 1.56e-3


def test_the_frames_of_known_bodies_move_with_what_they_are_fixed_to_and_have_their_error(motion):
    pose, error = make_pose(translation_m=(0.5, 1.0, -1.5)), make_pose(translation_m=(0.0, 0.2, 0.0))
    bodies = {
        "forearm": BodyMotionConfig(pose=pose, error=error, rate_hz=50.0),
        "stand": BodyMotionConfig(fixed_to="chaser", pose=pose, rate_hz=10.0),
    }
    kept = KeptMessages()
    truth = TruthPublisher(kept.node, motion, epoch_ns=EPOCH_NS, rate_hz=250.0, bodies=bodies)
    for tick in range(50):
        truth.publish(tick)
    arm, stand = (
        [read_odometry(message) for message in kept.of(BODY.at(frame).name)] for frame in ("forearm", "stand")
    )
    assert [odometry.stamp_ns for odometry in arm] == [EPOCH_NS + 5 * k * STEP_NS for k in range(10)]
    assert len(stand) == 2
    for k, odometry in enumerate(arm):
        expected = motion.state(k / 50.0).T_chaser_target.apply((0.5, 1.2, -1.5))
        np.testing.assert_allclose(odometry.pose.translation, expected, atol=1e-12)
        assert (odometry.frame_id, odometry.child_frame_id) == ("chaser", "forearm")
    np.testing.assert_allclose(stand[1].pose.as_matrix(), pose.as_matrix())
