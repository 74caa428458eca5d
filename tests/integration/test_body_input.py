"""Poses of known bodies on a real bus, as the estimator hears them."""

from time import monotonic

import numpy as np
import trimesh
from live_bus import TIMEOUT_S

from rpod_estimator.inputs.bodies import BodyInput
from rpod_pose.surroundings.bodies import KnownBodies
from rpod_schemas.config.estimator import EstimatorConfig, PmdInput
from rpod_schemas.config.surroundings import KnownBody
from rpod_schemas.messages import write_odometry
from rpod_schemas.poses import make_pose
from rpod_schemas.topics import BODY, CHASER
from rpod_schemas.types import Odometry

STAMP_NS, PERIOD_NS = 10**18, 10_000_000


def test_the_pose_of_an_arm_is_heard_up_to_a_frame_and_its_absence_and_wrong_frames_are_told(bus, tmp_path):
    trimesh.creation.box((0.1, 0.1, 1.0)).export(tmp_path / "arm.stl")
    arm = KnownBody(file="arm.stl", metres_per_unit=1.0, frame="forearm")
    bodies = KnownBodies.of({"arm": arm}, tmp_path)
    node = bus.node("estimator")
    config = EstimatorConfig.model_validate({"target": "mockup", "bus": bus.config, "sensors": [PmdInput()]})
    heard = BodyInput(node, config, bodies)
    heard.take_until(STAMP_NS)
    assert "bodies/forearm/odometry: no pose" in node.health.diagnostic(0).values["bodies"]
    publisher = bus.node("robots").publisher(BODY.at("forearm"))
    for number in range(20):
        reading = Odometry(
            stamp_ns=STAMP_NS + number * PERIOD_NS,
            frame_id=CHASER if number != 5 else "world",
            child_frame_id="forearm",
            pose=make_pose(translation_m=(0.01 * number, 0.0, 2.0)),
            linear_m_s=np.zeros(3),
            angular_rad_s=np.zeros(3),
            pose_covariance=np.zeros((6, 6)),
            twist_covariance=np.zeros((6, 6)),
        )
        publisher.publish(write_odometry(reading))
    last_ns, ends_s = STAMP_NS + 19 * PERIOD_NS, monotonic() + TIMEOUT_S
    while not bodies.tracks["forearm"].covers(last_ns) and monotonic() < ends_s:
        heard.take_until(last_ns)
    found = bodies.tracks["forearm"].at(last_ns + PERIOD_NS // 2)
    np.testing.assert_allclose(found.translation, [0.195, 0.0, 2.0])
    assert node.health.counters()["rejected/bodies/forearm/odometry/malformed"] == 1
    assert "bodies" not in node.health.diagnostic(0).values
