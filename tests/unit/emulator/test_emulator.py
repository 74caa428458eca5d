"""Which frames are made when: the emulator between a node and channels that only note what they are asked."""

import time
from functools import partial

import numpy as np
import pytest

from rpod_emulator.daemon import Emulator
from rpod_runtime import Received
from rpod_runtime.errors import RefusedError
from rpod_runtime.health import HealthBook
from rpod_schemas.config.emulator import EmulatorConfig
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.control import FaultRequest, StartRequest
from rpod_schemas.messages import write_clock, write_odometry, write_vector_stamped
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.rmw.wire import Attachment
from rpod_schemas.schedule import frame_at
from rpod_schemas.topics import CLOCK, SUN, TRUTH
from rpod_schemas.types import Health, Odometry

SECOND_NS = 1_000_000_000
STEP_NS = 4_000_000
EPOCH_NS = 1_767_225_600 * SECOND_NS
PMD = PmdConfig(rate_hz=10.0, T_chaser_sensor=make_pose(translation_m=[0.0, 0.0, 1.0]))


class FakeNode:
    def __init__(self):
        self.health = HealthBook("emulator")
        self.served, self.refused = {}, []
        self.follows_clock = False

    def serve(self, verb, _, handler, **__):
        self.served[verb] = handler

    def subscribe(self, topic, sink, **_):
        setattr(self, topic.name.replace("/", "_"), sink)

    def follow_clock(self, sink):
        self.clock, self.follows_clock = sink, True

    def reject(self, topic, error):
        self.refused.append((topic, str(error.reason)))


class FakeChannel:
    def __init__(self, sensor, log):
        self.sensor, self._log = sensor, log

    def emulate(self, poses, sun_W_m2, frame):
        self.poses, self.sun_W_m2 = poses, sun_W_m2
        self._log.append(("made", frame.sensor, frame.number))
        return partial(self._log.append, ("published", frame.sensor, frame.number))


class Bench:
    def __init__(self, *sensors, epoch_ns=EPOCH_NS, **config):
        sensors = sensors or (PMD,)
        self.node, self.log = FakeNode(), []
        self.channels = [FakeChannel(sensor, self.log) for sensor in sensors]
        configuration = EmulatorConfig(target="mockup", sensors=sensors, epoch_ns=epoch_ns, **config)
        self.emulator = Emulator(self.node, configuration, self.channels)

    def truth(self, first_s, last_s, *, epoch_ns=EPOCH_NS, sun_W_m2=1.0, clock_s=None):
        """Send truth at 250 Hz from one time to another, from the epoch, and the sun of its first second.

        In lockstep the clock is sent first, as of the end of the truth where it is not given.
        """
        if self.node.follows_clock:
            self.clock(epoch_ns + round((last_s if clock_s is None else clock_s) * SECOND_NS))
        if sun_W_m2 is not None:
            first_sun_ns = epoch_ns + int(first_s // 1) * SECOND_NS
            self.receive(SUN, write_vector_stamped(first_sun_ns, "chaser", np.array([0.0, 0.0, sun_W_m2])))
        for stamp_ns in range(
            epoch_ns + round(first_s * SECOND_NS), epoch_ns + round(last_s * SECOND_NS) + 1, STEP_NS
        ):
            odometry = Odometry(
                stamp_ns=stamp_ns,
                frame_id="chaser",
                child_frame_id="target",
                pose=make_pose(translation_m=[0.0, 0.0, 7.0]),
                linear_m_s=np.zeros(3),
                angular_rad_s=np.zeros(3),
            )
            self.receive(TRUTH, write_odometry(odometry), arrival_ns=stamp_ns)

    def clock(self, time_ns):
        self.receive(CLOCK, write_clock(time_ns))

    def receive(self, topic, message, arrival_ns=EPOCH_NS, damage=bytes):
        payload = memoryview(damage(encode(message)))
        sink = getattr(self.node, topic.name.replace("/", "_"))
        sink(Received(topic, "k", payload, Attachment(1, 0, bytes(16)), arrival_ns))

    def turn(self):
        """Do what the daemon's loop does once."""
        self.emulator.take_messages()
        for channel, frame in self.emulator.due():
            self.emulator.make(channel, frame)
        self.emulator.publish_made()

    @property
    def published(self):
        return [(sensor, number) for kind, sensor, number, *_ in self.log if kind == "published"]

    @property
    def counters(self):
        return self.node.health.counters()


def in_lockstep(*sensors, **config):
    return Bench(*sensors, time_source="clock", **config)


def test_a_frame_is_made_when_the_truth_covers_its_whole_exposure():
    bench = in_lockstep()
    last_sub_exposure_s = max(PMD.pose_times_s())
    bench.truth(0.0, 0.1 + last_sub_exposure_s - 0.004)
    bench.turn()
    assert bench.log == []
    bench.truth(0.1 + last_sub_exposure_s, 0.13)
    bench.turn()
    assert bench.published == [("pmd", 1)]


def test_the_poses_are_those_of_the_target_in_the_sensor():
    bench = in_lockstep()
    bench.truth(0.0, 0.2)
    bench.turn()
    (channel,) = bench.channels
    assert len(channel.poses) == len(PMD.pose_times_s())
    np.testing.assert_allclose(channel.poses[0].translation, [0.0, 0.0, 6.0])


def sun(time_s, watts):
    return write_vector_stamped(EPOCH_NS + round(time_s * SECOND_NS), "chaser", np.array([0.0, 0.0, watts]))


def test_the_last_sun_up_to_the_frame_shines():
    bench = in_lockstep()
    bench.truth(0.0, 0.2, sun_W_m2=None)
    for time_s, watts in ((-1.0, 5.0), (0.0, 7.0), (1.0, 9.0)):
        bench.receive(SUN, sun(time_s, watts))
    bench.turn()
    np.testing.assert_array_equal(bench.channels[0].sun_W_m2, [0.0, 0.0, 7.0])


def test_in_lockstep_a_frame_waits_for_its_sun():
    bench = in_lockstep()
    bench.truth(0.8, 1.03, sun_W_m2=7.0)
    bench.turn()
    assert bench.published[-1] == ("pmd", 9)
    bench.receive(SUN, sun(1.0, 9.0))
    bench.turn()
    assert bench.published[-1] == ("pmd", 10)
    np.testing.assert_array_equal(bench.channels[0].sun_W_m2, [0.0, 0.0, 9.0])


def test_by_the_wall_it_is_dark_until_the_sun_comes():
    bench = Bench()
    bench.truth(0.0, 0.2, sun_W_m2=None)
    bench.turn()
    np.testing.assert_array_equal(bench.channels[0].sun_W_m2, np.zeros(3))


def test_in_lockstep_every_frame_is_made_in_order_of_hand_over_and_name():
    side = PMD.model_copy(update={"name": "a_side"})
    bench = in_lockstep(PMD, side)
    bench.truth(0.0, 0.25)
    bench.turn()
    assert bench.published == [("a_side", 1), ("pmd", 1), ("a_side", 2), ("pmd", 2)]
    assert bench.counters["frames/pmd"] == 2


def test_in_lockstep_a_sensor_that_takes_long_hands_its_frame_out_after_younger_frames():
    slow = LidarConfig(rate_hz=5.0, readout_s=0.15)
    bench = in_lockstep(PMD, slow)
    bench.truth(0.0, 0.45)
    bench.turn()
    assert bench.published == [("pmd", 1), ("pmd", 2), ("pmd", 3), ("pmd", 4), ("lidar", 1)]


def test_in_lockstep_no_frame_is_made_before_the_clock_hands_it_out():
    bench = in_lockstep(PMD)
    bench.truth(0.0, 0.5, clock_s=0.2)
    bench.turn()
    assert bench.published == [("pmd", 1)], "the second is read out after its stamp"
    bench.clock(frame_at(PMD, 2, epoch_ns=EPOCH_NS).available_ns)
    bench.turn()
    assert bench.published == [("pmd", 1), ("pmd", 2)]


def test_in_lockstep_one_step_hands_out_one_frame_where_two_are_due_at_once():
    bench = in_lockstep(PMD, PMD.model_copy(update={"name": "a_side"}))
    first_ns = frame_at(PMD, 1, epoch_ns=EPOCH_NS).available_ns
    bench.truth(0.0, 0.15, clock_s=(first_ns - EPOCH_NS) / SECOND_NS)
    bench.turn()
    assert bench.published == [("a_side", 1)]
    bench.clock(first_ns + 1)
    bench.turn()
    assert bench.published == [("a_side", 1), ("pmd", 1)]


def test_in_lockstep_no_frame_is_made_beyond_the_end_of_the_scenario():
    bench = in_lockstep(PMD, epoch_ns=None, await_start=True)
    bench.node.served["start"](StartRequest(epoch_ns=EPOCH_NS, duration_s=0.2))
    bench.truth(0.0, 0.5)
    bench.turn()
    assert bench.published == [("pmd", 1), ("pmd", 2)]


def test_messages_that_follow_a_start_at_once_belong_to_its_run():
    bench = in_lockstep(PMD, epoch_ns=None, await_start=True)
    bench.node.served["start"](StartRequest(epoch_ns=EPOCH_NS))
    bench.truth(0.0, 0.15)
    bench.turn()
    assert bench.published == [("pmd", 1)]


def test_by_the_wall_only_the_newest_frame_is_made_and_the_others_are_counted():
    bench = Bench()
    bench.truth(0.0, 0.55)
    bench.turn()
    assert bench.published == [("pmd", 5)]
    assert bench.counters["skipped/pmd"] == 4


def test_an_epoch_of_long_ago_is_no_work():
    bench = Bench(epoch_ns=1)
    bench.truth(0.0, 0.2)
    bench.turn()
    assert len(bench.published) == 1


def test_frames_from_before_the_epoch_are_not_made():
    bench = in_lockstep()
    bench.truth(-2.0, 0.0)
    bench.turn()
    assert bench.log == []


def test_by_the_wall_a_frame_is_not_published_before_a_real_sensor_had_it():
    epoch_ns = time.time_ns() + 3600 * SECOND_NS
    bench = Bench(epoch_ns=epoch_ns)
    bench.truth(0.0, 0.2, epoch_ns=epoch_ns)
    bench.turn()
    assert [entry[0] for entry in bench.log] == ["made"]


def test_a_sensor_that_takes_long_does_not_hold_another_one_up():
    now_ns = time.time_ns()
    slow = LidarConfig(rate_hz=1.0, readout_s=3600.0)
    bench = Bench(PMD, slow, epoch_ns=now_ns)
    bench.truth(0.9, 1.05, epoch_ns=now_ns)
    bench.turn()
    assert ("made", "lidar", 1) in bench.log
    bench.emulator._made = [
        made if made.frame.sensor == "lidar" else type(made)(frame_of_the_past(made.frame), made.publish)
        for made in bench.emulator._made
    ]
    bench.emulator.publish_made()
    assert bench.published == [("pmd", 10)]


def frame_of_the_past(frame):
    return type(frame)(frame.stamp_ns, frame.sensor, frame.number, 0)


def test_a_gap_in_the_truth_costs_its_frames_only():
    bench = in_lockstep()
    bench.truth(0.0, 0.098)
    bench.truth(0.130, 0.25)
    bench.turn()
    assert bench.published == [("pmd", 2)]
    assert bench.counters["truth_gap/pmd"] == 1
    assert bench.node.health.diagnostic(0).level == Health.OK, "it is over"


def test_a_gap_is_a_warning_while_it_lasts():
    bench = in_lockstep()
    bench.truth(0.0, 0.098)
    bench.truth(0.130, 0.15)
    bench.turn()
    assert bench.node.health.diagnostic(0).level == Health.WARN


def test_truth_that_cannot_be_used_is_counted_by_reason():
    bench = in_lockstep()
    bench.truth(0.0, 0.05)
    bench.truth(0.02, 0.02)
    bench.receive(SUN, write_vector_stamped(1, "chaser", np.full(3, np.nan)))
    bench.receive(SUN, write_vector_stamped(1, "chaser", np.zeros(3)), damage=lambda payload: payload[:9])
    bench.turn()
    assert bench.node.refused == [
        ("truth/odometry", "late"),
        ("environment/sun", "not_finite"),
        ("environment/sun", "malformed"),
    ]
    bench.truth(0.054, 0.2)
    bench.turn()
    assert bench.published == [("pmd", 1)]


def test_a_stamp_from_the_future_does_not_stop_the_emulator():
    bench = Bench()
    bench.truth(0.0, 0.05)
    bench.receive(TRUTH, truth_message(EPOCH_NS + 99 * SECOND_NS), arrival_ns=EPOCH_NS)
    bench.truth(0.054, 0.2)
    bench.turn()
    assert bench.node.refused == [("truth/odometry", "future")]
    assert bench.published == [("pmd", 1)]


def truth_message(stamp_ns):
    return write_odometry(
        Odometry(
            stamp_ns=stamp_ns,
            frame_id="chaser",
            child_frame_id="target",
            pose=make_pose(),
            linear_m_s=np.zeros(3),
            angular_rad_s=np.zeros(3),
        )
    )


# --- start ---


def test_without_an_epoch_the_first_truth_is_it():
    bench = in_lockstep(epoch_ns=None)
    bench.truth(0.0, 0.2)
    bench.turn()
    assert bench.published == [("pmd", 1)]


def test_a_start_that_is_awaited_tells_the_epoch():
    bench = in_lockstep(epoch_ns=None, await_start=True)
    bench.truth(0.0, 0.2)
    bench.turn()
    assert bench.log == []
    bench.node.served["start"](StartRequest(epoch_ns=EPOCH_NS + SECOND_NS))
    bench.turn()
    bench.truth(1.0, 1.2)
    bench.turn()
    assert bench.published == [("pmd", 1)]


def test_a_second_start_plays_the_same_frames_again():
    bench = in_lockstep(epoch_ns=None, await_start=True)
    for _ in range(2):
        bench.node.served["start"](StartRequest(epoch_ns=EPOCH_NS))
        bench.turn()
        bench.truth(0.0, 0.2)
        bench.turn()
    assert bench.published == [("pmd", 1), ("pmd", 1)]
    assert bench.node.refused == []


# --- faults ---


def test_silence_publishes_nothing_and_is_counted():
    bench = Bench()
    bench.truth(0.0, 0.05)
    bench.turn()
    bench.node.served["fault"](FaultRequest(fault="silence", duration_s=10.0))
    bench.truth(0.054, 0.2)
    bench.turn()
    assert bench.log == []
    assert bench.counters["silenced/pmd"] == 1


def test_silence_is_refused_in_lockstep_which_would_wait_for_ever():
    bench = in_lockstep()
    with pytest.raises(RefusedError, match="blackout instead"):
        bench.node.served["fault"](FaultRequest(fault="silence", duration_s=10.0))
