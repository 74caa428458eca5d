"""A log onto a real bus: what subscribers get of it, and that an estimator takes it for its sensors."""

from contextlib import ExitStack
from dataclasses import replace
from threading import Event
from time import monotonic

import pytest
from live_bus import TIMEOUT_S, Bus, collect, daemon, first
from synthetic_log import EPOCH_NS, T_CHASER_SENSOR, SyntheticRun, approach, see_depth

from rpod_analysis import AnalysisError, open_log
from rpod_analysis.replay import Playback, play, replay
from rpod_estimator.daemon import run as run_estimator
from rpod_runtime import Inbox
from rpod_schemas.config.estimator import EstimatorConfig, PmdInput
from rpod_schemas.logs import REPLAY
from rpod_schemas.messages import read_diagnostics
from rpod_schemas.rmw.cdr import peek_stamp
from rpod_schemas.topics import CLOCK, DEPTH, DIAGNOSTICS, ESTIMATE, STATUS, TF_STATIC, TRUTH
from rpod_schemas.types import Camera
from rpod_target import load_target

CAMERA = Camera(width=88, height=72, fx=170.0, fy=170.0, cx=43.5, cy=35.5)
SECOND = 1_000_000_000


@pytest.fixture(scope="module")
def run():
    return SyntheticRun(
        duration_s=1.0, camera=CAMERA, target="mockup", render=see_depth(load_target("mockup"), CAMERA)
    )


@pytest.fixture(scope="module")
def log_path(run, tmp_path_factory):
    return run.write(tmp_path_factory.mktemp("playback") / "run.mcap")


def listen(bus, *topics):
    node, inbox = bus.node("listener"), Inbox()
    for topic in topics:
        node.subscribe(topic, inbox.put, recover=True)
    return inbox


def await_ready(health):
    """Wait until the estimator says what it does: it listens then."""

    def ready(received):
        return any(
            said.name == "estimator" and said.message != "starting"
            for said in read_diagnostics(received.decode())
        )

    assert first(health, ready, 4.0 * TIMEOUT_S), "it warms up"


def by_topic(received, topic):
    return [item for item in received if item.topic.name == topic.name]


def arrived(received, played, log) -> bool:
    """Return whether all that was played is there, with the time near the end of the log."""
    clock = by_topic(received, CLOCK)
    counts = {topic.name: len(by_topic(received, topic)) for topic in (DEPTH.of("pmd"), TF_STATIC, TRUTH)}
    at_the_end = bool(clock) and log.end_ns - peek_stamp(clock[-1].payload) < 0.5 * SECOND
    return at_the_end and all(count >= played.messages[name] for name, count in counts.items())


def test_subscribers_get_the_recorded_bytes_in_order_and_the_time_of_the_log(bus, log_path):
    inbox = listen(bus, DEPTH.of("pmd"), TF_STATIC, TRUTH, CLOCK)
    with open_log(log_path) as log:
        played = play(log, bus.node("replay"), Playback(speed=2.0), stop=Event())
        received = collect(inbox, sum(played.messages[t.name] for t in (DEPTH.of("pmd"), TF_STATIC, TRUTH)))
        deadline_s = monotonic() + TIMEOUT_S
        while not arrived(received, played, log) and monotonic() < deadline_s:
            received += inbox.wait(0.1)
        for topic in (DEPTH.of("pmd"), TF_STATIC, TRUTH):
            mine = by_topic(received, topic)
            assert [bytes(item.payload) for item in mine] == [m.payload for m in log.messages(topic)]
            assert [item.attachment.sequence for item in mine] == list(range(1, len(mine) + 1))
        clock = [peek_stamp(item.payload) for item in by_topic(received, CLOCK)]
        assert clock == sorted(set(clock))
        assert clock[0] == log.start_ns
        assert 0 <= log.end_ns - clock[-1] < 0.5 * SECOND, "the estimates that come last are not played"
    assert played.laps == 1
    assert not any(
        name.startswith(("estimate/", "diagnostics", "rosout", "parameter_events"))
        for name in played.messages
    )


def test_from_anywhere_with_chosen_topics_and_what_was_latched_before(bus, log_path):
    inbox = listen(bus, DEPTH.of("pmd"), TF_STATIC, TRUTH)
    playback = Playback(speed=4.0, start_s=0.45, end_s=0.85, topics=("pmd/depth/*", "tf_static"))
    with open_log(log_path) as log:
        played = play(log, bus.node("replay"), playback, stop=Event())
    assert dict(played.messages) == {"tf_static": 1, "pmd/depth/image_raw": 4}
    received = collect(inbox, 5)
    stamps = [
        round((peek_stamp(item.payload) - EPOCH_NS) / SECOND, 2)
        for item in by_topic(received, DEPTH.of("pmd"))
    ]
    assert stamps == [0.5, 0.6, 0.7, 0.8]
    assert len(by_topic(received, TF_STATIC)) == 1


def test_in_a_loop_stamps_and_clock_go_on_rising(bus, log_path):
    stop, stamps, times = Event(), [], []
    node = bus.node("listener")

    def take(received):
        stamps.append(peek_stamp(received.payload))
        if len(stamps) == 28:
            stop.set()

    node.subscribe(DEPTH.of("pmd"), take, recover=True)
    node.subscribe(CLOCK, lambda received: times.append(peek_stamp(received.payload)), recover=True)
    with open_log(log_path) as log:
        play(log, bus.node("replay"), Playback(speed=8.0, loop=True), stop=stop)
    assert len(stamps) >= 28
    assert stamps == sorted(set(stamps))
    assert times == sorted(set(times))
    laps = [stamp - EPOCH_NS for stamp in stamps[:22]]
    assert laps[:11] == [k * SECOND // 10 for k in range(11)]
    assert {later - earlier for earlier, later in zip(laps[:11], laps[11:], strict=True)} == {
        laps[11] - laps[0]
    }


def test_nothing_to_play_is_an_error(bus, log_path):
    with open_log(log_path) as log, pytest.raises(AnalysisError, match="no topic of a known type"):
        play(log, bus.node("replay"), Playback(topics=("lidar/*",)), stop=Event())


TRIES = 3
"""Number of times that a log is played: an estimator that stood still refuses frames or passes them over."""


def estimated(bus, log, config) -> tuple[list[bytes], list[bytes]]:
    """Return the estimates and statuses of an estimator to which a log is played, half a second a frame.

    The nodes end with the try: a player that stays would tell the next estimator the end of the log's time.
    """
    with ExitStack() as stack:
        mine = Bus(bus.endpoint, stack)
        inbox, health = listen(mine, ESTIMATE, STATUS), Inbox()
        mine.node("watcher").subscribe(DIAGNOSTICS, health.put)
        with daemon(run_estimator, config):
            await_ready(health)
            play(log, mine.node("replay"), Playback(speed=0.2), stop=Event())
            received = collect(inbox, 6 + 6)
    return tuple([bytes(item.payload) for item in by_topic(received, topic)] for topic in (ESTIMATE, STATUS))


@pytest.mark.parametrize("clock", [False, True], ids=["log of the wall clock", "log of a run in lockstep"])
def test_an_estimator_cannot_tell_it_from_its_sensors(bus, run, tmp_path, clock):
    """On the bus and in one process, the same frames make the same estimates, byte for byte."""
    path = replace(run, clock=clock, duration_s=0.5).write(tmp_path / "run.mcap")
    config = EstimatorConfig(
        target="mockup",
        bus=bus.config,
        sensors=(PmdInput(),),
        time_source="clock",
        initial_pose=T_CHASER_SENSOR * approach(0.0),
    )
    with open_log(path) as log:
        reference = replay(log, config, out=tmp_path / "reference.mcap")
        with open_log(reference.out) as replayed:
            ours = [bytes(message.payload) for message in replayed.messages(ESTIMATE.under(REPLAY))]
        assert ours
        for _ in range(TRIES):
            estimates, statuses = estimated(bus, log, config)
            if estimates == ours:
                break
    assert estimates == ours
    assert len(statuses) == 6


def test_a_topic_whose_name_no_key_can_have_is_left_out_and_told(bus, tmp_path):
    path = SyntheticRun(name="a#b").write(tmp_path / "run.mcap")
    with open_log(path) as log:
        played = play(log, bus.node("replay"), Playback(end_s=0.1), stop=Event())
    assert {name.split("/")[0] for name in played.left_out} == {"a#b"}
    assert played.messages[TRUTH.name] > 0
