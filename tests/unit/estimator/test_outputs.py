"""What the estimator publishes of a result."""

import numpy as np
from scipy.spatial.transform import Rotation

from rpod_estimator.outputs import Outputs
from rpod_pose.navigation.state import Output
from rpod_schemas.messages import read_pose
from rpod_schemas.poses import covariance_at, make_pose
from rpod_schemas.types import EstimatorStatus, Mode, Odometry

POSE = make_pose(rotation=Rotation.from_rotvec([0.3, -0.4, 1.0]), translation_m=(0.0, 0.5, 8.0))
GRAPPLE = make_pose(rotation=Rotation.from_rotvec([0.0, 1.0, 0.0]), translation_m=(1.5, 0.0, -0.5))


class Node:
    """Keeps what is published, by topic, in the order of publication."""

    def __init__(self):
        self.messages = {}

    def publisher(self, topic):
        return Publisher(self.messages, topic.name)


class Publisher:
    def __init__(self, messages, name):
        self._messages, self._name = messages, name

    def publish(self, message):
        self._messages[self._name] = message


def test_a_frame_of_the_target_is_published_with_the_covariance_at_its_place_before_the_status():
    node = Node()
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
    Outputs(node, "second", {"grapple": GRAPPLE}).publish(Output(status, odometry))
    message = node.messages["second/frames/grapple"]
    assert message.header.frame_id == "chaser"
    np.testing.assert_allclose(read_pose(message.pose.pose).as_matrix(), (POSE * GRAPPLE).as_matrix())
    arm_m = POSE.rotation.apply(GRAPPLE.translation)
    expected = covariance_at(covariance, arm_m)
    np.testing.assert_allclose(message.pose.covariance.reshape(6, 6), expected)
    assert expected[0, 0] > covariance[0, 0]
    assert list(node.messages)[-1] == "second/status"
