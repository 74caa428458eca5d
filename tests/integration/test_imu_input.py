"""The chaser's IMU on a real bus, as the estimator hears it."""

from time import monotonic

import numpy as np
from live_bus import TIMEOUT_S

from rpod_estimator.inputs.imu import ImuInput
from rpod_pose.navigation.dynamics.imu_track import ImuTrack
from rpod_schemas.config.estimator import EstimatorConfig, PmdInput
from rpod_schemas.messages import write_imu
from rpod_schemas.topics import CHASER, IMU
from rpod_schemas.types import ImuReading

STAMP_NS, PERIOD_NS = 10**18, 20_000_000


def an_input(bus, track, **dynamics):
    config = {"target": "mockup", "bus": bus.config, "sensors": [PmdInput()]}
    node = bus.node("estimator")
    checked = EstimatorConfig.model_validate({**config, "dynamics": {"imu": {}} | dynamics})
    return node, ImuInput(node, checked, track)


def publish(bus, count, **fields):
    publisher = bus.node("chaser").publisher(IMU)
    for number in range(count):
        stamp_ns = STAMP_NS + number * PERIOD_NS
        rate = np.array([0.0, 0.01, 0.0])
        publisher.publish(
            write_imu(ImuReading(stamp_ns=stamp_ns, frame_id=CHASER, rate_rad_s=rate, **fields))
        )


def test_readings_are_waited_for_up_to_a_frame(bus):
    track, last_ns, ends_s = ImuTrack(), STAMP_NS + 99 * PERIOD_NS, monotonic() + TIMEOUT_S
    node, imu = an_input(bus, track)
    publish(bus, 100)
    while not track.covers(last_ns) and monotonic() < ends_s:
        imu.take_until(last_ns)
    step = track.step(STAMP_NS, last_ns)
    np.testing.assert_allclose(step.rate_after_rad_s, [0.0, 0.01, 0.0])
    assert not step.unknown.any()
    assert "imu" not in node.health.diagnostic(0).values  # the alarm is gone


def test_a_reading_without_the_attitude_that_an_orbit_needs_is_rejected_and_told(bus):
    track, ends_s = ImuTrack(), monotonic() + TIMEOUT_S
    node, imu = an_input(bus, track, orbit={"period_s": 6000.0})
    publish(bus, 2)
    while node.health.counters().get("rejected/chaser/imu/malformed", 0) < 2 and monotonic() < ends_s:
        imu.take_until(STAMP_NS)
    assert node.health.counters()["rejected/chaser/imu/malformed"] == 2
    assert not track.covers(STAMP_NS)
    assert "chaser's rotation is unknown" in node.health.diagnostic(0).values["imu"]
