"""Every message of the facility's logs, through readers that know nothing of this project.

rosbags is also what this project decodes with; mcap_ros2 and the packages of Node.js are independent of it.
"""

from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

import pytest
from facility_logs import OPAQUE
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from readers import READERS, Read, read_node, read_rerun
from rosbags.highlevel import AnyReader

from rpod_schemas.topics import (
    BODY,
    CLOCK,
    COMMAND,
    CONTRADICTION,
    DEPTH_SIGMA,
    ESTIMATE_FRAME,
    ESTIMATE_JOINTS,
    FAULTS,
    IMU,
    TOPICS,
    TRUTH_JOINTS,
)

BY_EACH = [pytest.param(read, id=name, marks=pytest.mark.needs(name)) for name, read in READERS.items()]


def by_topic(messages: Iterable[Read]) -> dict[str, list[Read]]:
    topics: dict[str, list[Read]] = defaultdict(list)
    for message in messages:
        topics[message.topic].append(message)
    return dict(topics)


def statistics(path: Path) -> dict[str, int]:
    """Return the number of messages of each topic by the log's own statistics."""
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary
    assert summary.statistics
    counts = summary.statistics.channel_message_counts
    return {channel.topic: counts[channel.id] for channel in summary.channels.values()}


@pytest.mark.parametrize("read", BY_EACH)
def test_every_message_of_every_topic_is_decoded_as_we_decode_it(read, log, ours):
    theirs, expected = by_topic(read(log)), by_topic(ours)
    assert {topic: len(messages) for topic, messages in theirs.items()} == statistics(log)
    assert theirs.keys() == expected.keys()
    for topic, messages in expected.items():
        assert theirs[topic] == messages, topic


def test_the_log_with_every_sensor_holds_every_topic_that_the_facility_publishes(every_sensor):
    reserved = {BODY, COMMAND, IMU}
    # The mock-up has no frames and joints, its camera states no noise, and the run has no faults.
    of_other_runs = {ESTIMATE_FRAME, ESTIMATE_JOINTS, FAULTS, TRUTH_JOINTS, DEPTH_SIGMA}
    sensors = {"<camera>": "pmd", "<lidar>": "lidar"}
    names = [topic.name.split("/") for topic in TOPICS if topic not in reserved | of_other_runs]
    expected = {"/" + "/".join(sensors.get(part, part) for part in parts) for parts in names}
    assert statistics(every_sensor).keys() | {f"/{CONTRADICTION.name}"} == expected  # of refused frames alone


@pytest.mark.needs("rosbags")
def test_rosbags_reads_the_messages_beside_opaque_bytes(opaque):
    with AnyReader([opaque]) as bag:
        assert {connection.topic for connection in bag.connections} == {f"/{OPAQUE.name}", f"/{CLOCK.name}"}
        clocks = [connection for connection in bag.connections if connection.msgtype == CLOCK.type]
        numbers = [
            bag.deserialize(data, item.msgtype).clock.nanosec for item, _, data in bag.messages(clocks)
        ]
    assert numbers == [1, 2]


@pytest.mark.needs("mcap_ros2")
def test_mcap_ros2_reads_the_messages_beside_opaque_bytes(opaque):
    with opaque.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        rows = list(reader.iter_decoded_messages(topics=[f"/{CLOCK.name}"]))
    assert [message.clock.nanosec for *_, message in rows] == [1, 2]


@pytest.mark.needs("rerun")
def test_rerun_reads_the_messages_beside_opaque_bytes(opaque):
    assert [read.message["clock"]["nanosec"] for read in read_rerun(opaque)] == [1, 2]


@pytest.mark.needs("node")
def test_node_reads_the_messages_and_the_opaque_bytes(opaque):
    found = by_topic(read_node(opaque))
    assert [read.message["clock"]["nanosec"] for read in found[f"/{CLOCK.name}"]] == [1, 2]
    assert all(read.message["bytes"] for read in found[f"/{OPAQUE.name}"])
