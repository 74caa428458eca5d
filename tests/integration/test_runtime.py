"""Nodes on a real bus: what is published arrives or is counted as missed, and nothing is lost in silence."""

import logging
import threading
import time
from contextlib import ExitStack
from threading import Event

import numpy as np
import pytest
import zenoh
from facility_process import until
from live_bus import TIMEOUT_S, collect, first

from rpod_runtime import Inbox, Node
from rpod_runtime.bus.session import open_client
from rpod_schemas.messages import (
    read_diagnostics,
    read_vector_stamped,
    write_clock,
    write_odometry,
    write_vector_stamped,
)
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.rmw.wire import Attachment, GraphNode, token_pattern, topic_of_token
from rpod_schemas.topics import CLOCK, COMMAND, DIAGNOSTICS, SMALL_CACHE, SUN, TRUTH, Namespace, Topic
from rpod_schemas.types import Health, Odometry

KEYS = Namespace()
VECTOR = "geometry_msgs/msg/Vector3Stamped"
STREAM = Topic("test/stream", VECTOR)
BURST = 1500


def vector(number: int):
    return write_vector_stamped(number, "chaser", np.array([number, 0.0, 0.0]))


def numbers(items) -> list[int]:
    return [read_vector_stamped(item.decode())[0] for item in items]


def truth_message():
    odometry = Odometry(
        stamp_ns=1,
        frame_id="chaser",
        child_frame_id="target",
        pose=make_pose(),
        linear_m_s=np.zeros(3),
        angular_rad_s=np.zeros(3),
    )
    return write_odometry(odometry)


def heard_from_the_first(publisher, inbox: Inbox, number: int = 0) -> None:
    """Publish until the subscription is known to the publisher, then empty the inbox of what came."""
    for _ in range(200):
        publisher.publish(vector(number))
        if inbox.wait(0.05):
            break
    while inbox.wait(0.1):
        pass


@pytest.fixture
def bare(bus):
    """A Zenoh client without a node."""
    with open_client(bus.config) as session:
        yield session


# --- data plane ---


def test_a_message_arrives_as_it_was_sent_with_its_attachment(bus):
    inbox, sender = Inbox(), bus.node("sender")
    bus.node("receiver").subscribe(SUN, inbox.put)
    publisher = sender.publisher(SUN)
    publisher.publish(vector(1))
    (one,) = collect(inbox, 1)
    publisher.publish(vector(2))
    (two,) = collect(inbox, 1)
    assert one.topic == SUN
    assert one.key == KEYS.key(SUN)
    assert bytes(one.payload) == bytes(encode(vector(1)))
    assert (one.attachment.sequence, two.attachment.sequence) == (1, 2)
    assert one.attachment.gid == two.attachment.gid
    assert 0 <= one.arrival_ns - one.attachment.stamp_ns < TIMEOUT_S * 1e9
    assert publisher.published == 2


def test_who_comes_late_gets_the_last_message_of_a_latched_topic(bus):
    # A namespace of its own: another test's publisher may not be gone from the router yet.
    publisher, inbox = bus.node("sender", namespace="latched").publisher(SUN), Inbox()
    for number in (1, 2, 3):
        publisher.publish(vector(number))
    bus.node("late", namespace="latched").subscribe(SUN, inbox.put)
    assert first(inbox, lambda received: numbers([received]) == [3])


def test_who_comes_late_gets_the_past_of_a_stream_only_if_asked_for(bus):
    publisher, late = bus.node("sender").publisher(STREAM), bus.node("late")
    for number in range(1, SMALL_CACHE + 11):
        publisher.publish(vector(number))
    past, present = Inbox(), Inbox()
    late.subscribe(STREAM, past.put, history=True)
    bus.node("later").subscribe(STREAM, present.put)
    assert numbers(collect(past, SMALL_CACHE)) == list(range(11, SMALL_CACHE + 11))
    heard_from_the_first(publisher, present)
    assert late.account.counts[KEYS.key(STREAM)].missed == 0


@pytest.mark.parametrize("receivers", [1, 3])
def test_of_a_burst_every_message_arrives_or_is_counted_as_missed(bus, receivers):
    publisher = bus.node("sender").publisher(STREAM)
    nodes, inboxes = [], []
    for number in range(receivers):
        inbox, node = Inbox(), bus.node(f"receiver{number}")
        node.subscribe(STREAM, inbox.put, recover=True)
        heard_from_the_first(publisher, inbox)
        nodes.append(node)
        inboxes.append(inbox)
    for inbox in inboxes:
        while inbox.wait(0.1):
            pass
    before = publisher.published
    for number in range(BURST):
        publisher.publish(vector(before + 1 + number))
    for node, inbox in zip(nodes, inboxes, strict=True):
        count = node.account.counts[KEYS.key(STREAM)]
        missed_before = count.missed
        got: list[int] = []
        while len(got) + count.missed - missed_before < BURST:
            more = collect(inbox, 1)
            assert more, f"{BURST - len(got)} of {BURST} are gone, {count.missed} of them counted"
            got += numbers(more)
        assert got == sorted(set(got)), "in order, none of them twice"
        assert got[-1] == before + BURST, "the last one comes, by the publisher's heartbeat at the latest"
        assert len(got) + count.missed - missed_before == BURST
        assert count.duplicates == 0


def test_a_missed_message_is_counted_in_the_diagnostics(bus, bare):
    inbox, receiver = Inbox(), bus.node("receiver")
    receiver.subscribe(STREAM, inbox.put)
    put(bare, STREAM, Attachment(4, 0, b"g" * 16), inbox)
    bare.put(KEYS.key(STREAM), encode(vector(1)), attachment=Attachment(9, 0, b"g" * 16).pack())
    assert collect(inbox, 1)
    counters = receiver.status().counters
    assert (counters["received/test/stream"], counters["missed/test/stream"]) == (2, 4)


def put(session: zenoh.Session, topic: Topic, attachment: Attachment | bytes | None, inbox: Inbox) -> None:
    """Put a message until it arrives the first time; the subscription may not be known yet."""
    packed = attachment.pack() if isinstance(attachment, Attachment) else attachment
    for _ in range(200):
        session.put(KEYS.key(topic), encode(vector(1)), attachment=packed)
        if inbox.wait(0.05):
            return
    raise AssertionError("nothing arrives")


def test_duplicates_are_counted_and_not_handed_over(bus, bare):
    inbox, receiver = Inbox(), bus.node("receiver")
    receiver.subscribe(STREAM, inbox.put)
    put(bare, STREAM, Attachment(5, 0, b"g" * 16), inbox)
    for sequence in (5, 4, 6):
        packed = Attachment(sequence, sequence, b"g" * 16).pack()
        bare.put(KEYS.key(STREAM), encode(vector(sequence)), attachment=packed)
    assert [item.attachment.sequence for item in collect(inbox, 1)] == [6]
    assert receiver.status().counters["rejected/test/stream/duplicate"] >= 2
    assert receiver.status().counters["received/test/stream"] == 2


def test_a_forged_number_far_ahead_does_not_silence_its_publisher_and_is_told(bus, bare):
    inbox, diagnostics, receiver = Inbox(), Inbox(), bus.node("receiver")
    bus.node("watcher").subscribe(DIAGNOSTICS, diagnostics.put, recover=True)
    receiver.subscribe(STREAM, inbox.put)
    gid = b"g" * 16
    put(bare, STREAM, Attachment(5, 0, gid), inbox)
    for sequence in (2**40, 6, 7, 2**40 + 1, 8):
        bare.put(KEYS.key(STREAM), encode(vector(1)), attachment=Attachment(sequence, 0, gid).pack())
    assert [item.attachment.sequence for item in collect(inbox, 3)] == [6, 7, 8]
    name = "sequence_jump/test/stream"

    def told(received):
        return [item for item in read_diagnostics(received.decode()) if name in item.values]

    (told_of,) = first(diagnostics, told)
    assert f", publisher {gid.hex()}: more than 1000 numbers; stop a second publisher" in told_of.values[name]
    assert told_of.level == Health.WARN
    assert receiver.status().counters["rejected/test/stream/sequence_jump"] == 2
    assert receiver.status().counters["missed/test/stream"] == 0


def test_a_forged_message_under_a_publishers_gid_silences_nobody_and_is_told(bus, bare):
    inbox, diagnostics, receiver = Inbox(), Inbox(), bus.node("receiver")
    bus.node("watcher").subscribe(DIAGNOSTICS, diagnostics.put, recover=True)
    receiver.subscribe(STREAM, inbox.put, recover=True)
    publisher = bus.node("sender").publisher(STREAM)
    heard_from_the_first(publisher, inbox)
    publisher.publish(vector(1))
    (genuine,) = collect(inbox, 1)
    gid = genuine.attachment.gid
    forged = Attachment(genuine.attachment.sequence + 900, 0, gid).pack()
    bare.put(KEYS.key(STREAM), encode(vector(9)), attachment=forged)
    until(lambda: receiver.status().counters.get("rejected/test/stream/second_source"))
    for number in range(2, 7):
        publisher.publish(vector(number))
    assert numbers(collect(inbox, 5)) == [2, 3, 4, 5, 6]
    assert receiver.status().counters["missed/test/stream"] == 0
    name = "second_source/test/stream"

    def told(received):
        return [item for item in read_diagnostics(received.decode()) if name in item.values]

    (told_of,) = first(diagnostics, told)
    assert f"gid {gid.hex()} (session {genuine.session}) is used by a second session" in told_of.values[name]
    assert told_of.level == Health.WARN


def test_topics_without_end_get_no_tokens_without_end(bus, bare, monkeypatch):
    monkeypatch.setattr("rpod_runtime.node.MOST_KEYS", 3)
    receiver = bus.node("receiver", namespace="shown")
    keys = Namespace(0, "shown")
    receiver.subscribe_all([STREAM.under("*")], lambda _: None)
    graph = GraphNode(keys, str(bare.zid()), "liar")
    with ExitStack() as stack:
        for number in range(6):
            token = graph.endpoint_token("MP", number, STREAM.under(f"t{number}"))
            stack.callback(bare.liveliness().declare_token(token).undeclare)
        shown = token_pattern(keys, "MS", "receiver", STREAM.under("*"))
        until(lambda: len(list(bare.liveliness().get(shown))) >= 3)
        bus.node("later", namespace="shown")  # what was declared before is known now
        assert len(list(bare.liveliness().get(shown))) == 3


def test_a_publisher_that_begins_at_0_is_heard_from_its_first_message(bus, bare):
    inbox, receiver = Inbox(), bus.node("receiver")
    receiver.subscribe(STREAM, inbox.put)
    put(bare, STREAM, Attachment(0, 0, b"g" * 16), inbox)
    bare.put(KEYS.key(STREAM), encode(vector(1)), attachment=Attachment(1, 0, b"g" * 16).pack())
    assert [item.attachment.sequence for item in collect(inbox, 1)] == [1]


@pytest.mark.parametrize(
    ("attachment", "reason", "words"),
    [
        (b"\x0fsequence_number" + bytes(60), "old_attachment", "labelled attachment of an rmw_zenoh before"),
        (None, "malformed", "no attachment"),
        (bytes(12), "malformed", "attachment of 12 bytes"),
    ],
)
def test_a_message_without_a_usable_attachment_is_refused_by_name(  # noqa: PLR0917 - fixtures
    bus, bare, caplog, attachment, reason, words
):
    inbox, receiver = Inbox(), bus.node("receiver")
    receiver.subscribe(STREAM, inbox.put)
    put(bare, STREAM, Attachment(1, 0, b"g" * 16), inbox)
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            bare.put(KEYS.key(STREAM), encode(vector(1)), attachment=attachment)
        bare.put(KEYS.key(STREAM), encode(vector(1)), attachment=Attachment(2, 0, b"g" * 16).pack())
        assert len(collect(inbox, 1)) == 1
    assert receiver.status().counters[f"rejected/test/stream/{reason}"] == 3
    assert caplog.text.count(words) == 1, "logged once, counted always"


def test_a_restarted_publisher_has_a_new_identity_and_is_counted_anew(bus):
    inbox, receiver = Inbox(), bus.node("receiver")
    receiver.subscribe(SUN, inbox.put)
    gids = set()
    for _ in range(2):
        with Node(bus.node("sender").config, version="test") as sender:
            publisher = sender.publisher(SUN)
            publisher.publish(vector(1))
            (item,) = collect(inbox, 1)
            gids.add(item.attachment.gid)
            assert item.attachment.sequence == 1
    count = receiver.account.counts[KEYS.key(SUN)]
    assert (len(gids), count.received, count.missed, count.duplicates) == (2, 2, 0, 0)


def test_a_sink_that_fails_is_counted_and_the_next_message_is_handed_over(bus, caplog):
    inbox, receiver = Inbox(), bus.node("receiver")

    def fail_once(received) -> None:
        inbox.put(received)
        if received.attachment.sequence == 1:
            raise RuntimeError("no such luck")

    receiver.subscribe(SUN, fail_once)
    publisher = bus.node("sender").publisher(SUN)
    with caplog.at_level(logging.ERROR):
        for number in (1, 2):
            publisher.publish(vector(number))
            assert len(collect(inbox, 1)) == 1
        publisher.publish(vector(3))
        assert len(collect(inbox, 1)) == 1
    assert receiver.status().counters["failed/environment/sun"] == 1
    assert "no such luck" in caplog.text


def test_a_pattern_hears_topics_that_come_later_each_under_its_own_name(bus):
    inbox, receiver = Inbox(), bus.node("receiver")
    receiver.subscribe_all([Topic("*/stream", VECTOR)], inbox.put)
    sender = bus.node("sender")
    for name in ("one", "two"):
        sender.publisher(Topic(f"{name}/stream", VECTOR)).publish(vector(1))
        (item,) = collect(inbox, 1)
        assert item.topic == Topic(f"{name}/stream", VECTOR)


# --- time ---


def test_the_clock_of_the_bus_is_followed_and_never_goes_back(bus):
    follower = bus.node("follower", time_source="clock")
    assert follower.clock.now_ns() == 0
    publisher, seen = bus.node("motion").publisher(CLOCK), Inbox()
    bus.node("witness").subscribe(CLOCK, seen.put, history=True)
    for stamp_ns in (7_000_000_000, 5_000_000_000):
        for _ in range(200):
            publisher.publish(write_clock(stamp_ns))
            if collect(seen, 1, 0.05) and follower.clock.now_ns():
                break
    assert follower.clock.now_ns() == 7_000_000_000


# --- health ---


def told_by(instance: str, message: str = ""):
    """Return what picks an instance's diagnostics, those with a message if asked for."""

    def pick(received):
        told = read_diagnostics(received.decode())
        return [item for item in told if item.name == instance and message in item.message]

    return pick


def test_a_change_of_health_is_told_before_the_next_heartbeat(bus, monkeypatch):
    monkeypatch.setattr("rpod_runtime.node._DIAGNOSTICS_PERIOD_S", 3600.0)
    inbox = Inbox()
    bus.node("watcher").subscribe(DIAGNOSTICS, inbox.put)
    node = bus.node("worker")
    for message in ("slow disk", "disk full"):
        node.health.report(Health.ERROR, message)
        assert first(inbox, told_by("worker", message))[0].level == Health.ERROR


def test_the_heart_beats_without_any_change_and_no_faster_than_its_period(bus, monkeypatch):
    monkeypatch.setattr("rpod_runtime.node._DIAGNOSTICS_PERIOD_S", 0.3)
    inbox = Inbox()
    bus.node("watcher").subscribe(DIAGNOSTICS, inbox.put)
    bus.node("worker")
    stamps_ns = [first(inbox, told_by("worker"))[0].stamp_ns for _ in range(4)]
    assert min(np.diff(stamps_ns[1:])) > 0.25e9


def test_the_diagnostics_carry_the_counters(bus):
    inbox, node = Inbox(), bus.node("worker")
    bus.node("watcher").subscribe(DIAGNOSTICS, inbox.put)
    node.publisher(SUN).publish(vector(1))
    node.health.count("frames/pmd", 3)

    def counted(received):
        return [
            item.values
            for item in read_diagnostics(received.decode())
            if item.name == "worker" and item.values.get("published/environment/sun") == "1"
        ]

    (values,) = first(inbox, counted)
    assert values["frames/pmd"] == "3"
    assert int(values["published/diagnostics"]) >= 1


def test_the_last_words_of_a_node_are_heard(bus):
    inbox = Inbox()
    bus.node("watcher").subscribe(DIAGNOSTICS, inbox.put)
    with Node(bus.node("template").config.model_copy(update={"instance": "short"}), version="t") as node:
        node.health.report(Health.OK, "finished in time")
    assert first(inbox, told_by("short", "finished in time"))


# --- the graph ---


def tokens(session: zenoh.Session) -> set[str]:
    return {
        str(reply.ok.key_expr)
        for reply in session.liveliness().get("@ros2_lv/0/**", timeout=TIMEOUT_S)
        if reply.ok
    }


def tokens_of(session: zenoh.Session, node: str, *, count: int) -> list[str]:
    """Return a node's tokens once there are as many as expected: they take a moment to get around."""
    deadline_s = time.monotonic() + TIMEOUT_S
    while True:
        mine = [token for token in tokens(session) if token.split("/")[8] == node]
        if len(mine) == count or time.monotonic() > deadline_s:
            return mine


def test_node_publishers_and_subscribers_are_seen_in_the_graph_until_the_node_ends(bus, bare):
    node = bus.node("seen")
    node.publisher(TRUTH)
    node.subscribe(COMMAND, Inbox().put)
    mine = tokens_of(bare, "seen", count=13)  # node, four publishers, subscriber, seven services
    kinds = {token.split("/")[5]: topic_of_token(token, KEYS) for token in mine if token.count("/") > 9}
    published = {topic_of_token(token, KEYS).name for token in mine if "/MP/" in token}
    assert sum("/NN/" in token for token in mine) == 1
    assert published == {"diagnostics", "rosout", "parameter_events", TRUTH.name}
    assert sum("/SS/" in token for token in mine) == 7
    assert kinds["MS"].name == COMMAND.name
    node.__exit__(None, None, None)
    assert tokens_of(bare, "seen", count=0) == []


# --- ends ---


def test_a_node_leaves_no_thread_and_no_subscription_behind(bus):
    inbox, publisher = Inbox(), bus.node("sender").publisher(SUN)
    template = bus.node("template").config
    before = set(threading.enumerate())
    with Node(template, version="test") as node:
        node.subscribe(SUN, inbox.put)
        node.subscribe(TRUTH, inbox.put, recover=True, history=True)
        publisher.publish(vector(1))
        assert collect(inbox, 1)
        started = set(threading.enumerate()) - before
        assert started
    assert not [thread for thread in started if thread.is_alive() and thread.name == "diagnostics"]
    publisher.publish(vector(2))
    witness = Inbox()
    bus.node("witness").subscribe(SUN, witness.put)
    assert numbers(collect(witness, 1)) == [2]
    assert inbox.wait(0.0) == []


def test_a_start_that_fails_half_way_leaves_nothing_open(bus, bare, monkeypatch):
    config = bus.node("template").config.model_copy(update={"instance": "broken"})

    def fail(*_):
        raise RuntimeError("half-way")

    monkeypatch.setattr(Node, "serve", fail)
    with pytest.raises(RuntimeError, match="half-way"):
        Node(config, version="test").__enter__()
    assert not [token for token in tokens(bare) if token.split("/")[8] == "broken"]


def test_what_fails_inside_a_node_is_raised_and_the_node_is_stopped(bus):
    stop = Event()
    node = Node(bus.node("template").config, version="test", stop=stop)
    with pytest.raises(RuntimeError, match="boom"), node:
        raise RuntimeError("boom")
    assert stop.is_set()
    assert node.state == "failed"
