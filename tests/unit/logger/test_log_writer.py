"""One MCAP file, read back by three independent readers."""

import errno
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from mcap.exceptions import EndOfFile, InvalidMagic
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability

from rpod_logger import writer
from rpod_logger.writer import WriterSettings, channel_topic, create_log
from rpod_schemas.rmw.cdr import type_hash
from rpod_schemas.topics import CLOCK, DIAGNOSTICS, ROSOUT, TF_STATIC, Namespace, Topic
from rpod_security.log_verification import verify

SETTINGS = WriterSettings(Namespace(), "rpod test")
RAW = Topic("lab/raw", "")


def test_wire_bytes_times_and_sequence_come_back_unchanged(tmp_path, arrive):
    received = [arrive(CLOCK, number) for number in (1, 2, 3)]
    log = create_log(tmp_path, "run", SETTINGS)
    for message in received:
        log.write(message)
    log.close()
    with log.path.open("rb") as stream:
        reader = make_reader(stream)
        rows = [
            (schema.name, schema.encoding, channel.message_encoding, channel.topic, message)
            for schema, channel, message in reader.iter_messages()
        ]
        assert reader.get_header().profile == "ros2"
    assert {row[:4] for row in rows} == {("rosgraph_msgs/msg/Clock", "ros2msg", "cdr", "/clock")}
    assert [(row[4].data, row[4].log_time, row[4].publish_time, row[4].sequence) for row in rows] == [
        (bytes(m.payload), m.arrival_ns, m.attachment.stamp_ns, m.attachment.sequence) for m in received
    ]


def test_rosbags_and_mcap_ros2_decode_every_message(tmp_path, arrive):
    log = create_log(tmp_path, "run", SETTINGS)
    log.write(arrive(TF_STATIC, 1))
    log.write(arrive(CLOCK, 2))
    log.close()
    with AnyReader([log.path]) as bag:
        decoded = {c.topic: bag.deserialize(data, c.msgtype) for c, _, data in bag.messages()}
    assert decoded["/tf_static"].transforms[0].transform.translation.x == 1.0
    assert decoded["/clock"].clock.nanosec == 2
    with log.path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        names = {channel.topic for _, channel, _, _ in reader.iter_decoded_messages()}
    assert names == {"/tf_static", "/clock"}


def test_rosbags_reads_the_quality_of_service_and_the_type_hash(tmp_path, arrive):
    log = create_log(tmp_path, "run", SETTINGS)
    log.write(arrive(TF_STATIC, 1))
    log.write(arrive(CLOCK, 1))
    log.write(arrive(ROSOUT, 1, payload=b""))
    log.close()
    with AnyReader([log.path]) as bag:
        qos = {c.topic: c.ext.offered_qos_profiles[0] for c in bag.connections}
    assert (qos["/tf_static"].durability, qos["/tf_static"].depth) == (QosDurability.TRANSIENT_LOCAL, 1)
    assert (qos["/clock"].durability, qos["/clock"].depth) == (QosDurability.VOLATILE, 10)
    assert (qos["/rosout"].durability, qos["/rosout"].depth) == (QosDurability.TRANSIENT_LOCAL, 1000)
    assert {profile.reliability for profile in qos.values()} == {QosReliability.RELIABLE}
    with log.path.open("rb") as stream:
        channels = make_reader(stream).get_summary().channels.values()
    assert {channel.topic: channel.metadata["topic_type_hash"] for channel in channels} == {
        "/tf_static": type_hash(TF_STATIC.type),
        "/clock": type_hash(CLOCK.type),
        "/rosout": type_hash(ROSOUT.type),
    }


def test_each_publisher_of_a_stream_has_a_channel_of_its_own_and_those_of_diagnostics_share_one(
    tmp_path, arrive, monkeypatch
):
    monkeypatch.setattr(writer, "_MOST_CHANNELS", 3)
    log = create_log(tmp_path, "run", SETTINGS)
    for number, gid in enumerate((b"a", b"b", b"a", b"c", b"d")):
        log.write(arrive(CLOCK, number + 1, gid=gid * 16))
        log.write(arrive(DIAGNOSTICS, number + 1, payload=b"", gid=gid * 16))
    log.close()
    with log.path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    found = sorted(
        (
            channel.topic,
            channel.metadata.get("publisher", ""),
            summary.statistics.channel_message_counts[number],
        )
        for number, channel in summary.channels.items()
    )
    assert found == [
        ("/clock", "", 2),
        ("/clock", "61" * 16, 2),
        ("/clock", "62" * 16, 1),
        ("/diagnostics", "", 5),
    ]


def test_opaque_bytes_are_kept_and_do_not_hinder_rosbags(tmp_path, arrive):
    log = create_log(tmp_path, "run", SETTINGS)
    log.write(arrive(RAW, 1, payload=b"\x01\x02 not CDR"))
    log.write(arrive(CLOCK, 2))
    log.close()
    with log.path.open("rb") as stream:
        found = {c.topic: (s.name, m.data) for s, c, m in make_reader(stream).iter_messages()}
    assert found["/lab/raw"] == ("opaque", b"\x01\x02 not CDR")
    with AnyReader([log.path]) as bag:
        clocks = [c for c in bag.connections if c.topic == "/clock"]
        assert len(list(bag.messages(clocks))) == 1


def test_an_existing_file_is_never_overwritten(tmp_path, arrive):
    paths = []
    for number in (1, 2, 3):
        log = create_log(tmp_path / "deep", "run", SETTINGS)
        log.write(arrive(CLOCK, number))
        log.close()
        paths.append(log.path.name)
    assert paths == ["run.mcap", "run_0002.mcap", "run_0003.mcap"]
    for number, name in enumerate(paths, start=1):
        with (tmp_path / "deep" / name).open("rb") as stream:
            assert [m.sequence for _, _, m in make_reader(stream).iter_messages()] == [number]


def test_a_file_sorts_behind_all_earlier_ones_of_its_name_whichever_are_left(tmp_path, arrive):
    create_log(tmp_path, "run_later", SETTINGS).close()
    for number in range(1, 13):
        log = create_log(tmp_path, "run", SETTINGS)
        log.write(arrive(CLOCK, number))
        log.close()
        if number == 6:
            (tmp_path / "run.mcap").unlink()
            (tmp_path / "run_0004.mcap").unlink()
    names = sorted(path.name for path in tmp_path.glob("run*.mcap"))
    assert names == [*(f"run_{number:04d}.mcap" for number in (2, 3, *range(5, 13))), "run_later.mcap"]


def test_a_log_that_cannot_begin_leaves_no_file_open(tmp_path, monkeypatch):
    def refused(*_, **__):
        raise OSError(errno.EIO, "input/output error")

    monkeypatch.setattr(writer.Writer, "start", refused)
    before = len(list(Path("/proc/self/fd").iterdir()))
    with pytest.raises(OSError, match="input/output") as refusal:  # holds what the failed call had
        create_log(tmp_path, "run", replace(SETTINGS, chained=True))
    assert refusal
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_a_chain_whose_log_was_deleted_leaves_no_empty_log(tmp_path, arrive):
    settings = replace(SETTINGS, chained=True)
    (tmp_path / "run.mcap.chain").write_text("of a log that was deleted")
    log = create_log(tmp_path, "run", settings)
    log.write(arrive(CLOCK, 1))
    log.close()
    assert [path.name for path in tmp_path.glob("*.mcap")] == ["run_0002.mcap"]
    assert verify(log.path).intact


def test_what_was_synced_is_readable_without_a_close(tmp_path, arrive):
    log = create_log(tmp_path, "run", SETTINGS)
    log.add_metadata("software", {"name": "rpod"})
    log.write(arrive(CLOCK, 1))
    log.sync()
    log.write(arrive(CLOCK, 2))
    records = _records(log.path)
    log.close()
    chunks = [record for record in records if isinstance(record, Chunk)]
    assert [(chunk.message_start_time, chunk.message_end_time) for chunk in chunks] == [
        (arrive(CLOCK, 1).arrival_ns, arrive(CLOCK, 1).arrival_ns)
    ]
    assert any(type(record).__name__ == "Metadata" for record in records)


def test_a_chunk_never_exceeds_its_limit_unless_one_message_does(tmp_path, arrive):
    settings = WriterSettings(Namespace(), "rpod test", chunk_bytes=10_000)
    log = create_log(tmp_path, "run", settings)
    for number in range(1, 30):
        log.write(arrive(RAW, number, payload=bytes(3_000)))
    log.write(arrive(RAW, 30, payload=bytes(25_000)))
    log.close()
    sizes = [record.uncompressed_size for record in _records(log.path) if isinstance(record, Chunk)]
    assert sizes[-1] > 25_000
    assert max(sizes[:-1]) <= 10_000


@pytest.mark.parametrize("compression", ["lz4", "none"])
def test_compression_is_as_configured(tmp_path, arrive, compression):
    log = create_log(tmp_path, "run", WriterSettings(Namespace(), "rpod test", compression=compression))
    log.write(arrive(CLOCK, 1))
    log.close()
    found = {record.compression for record in _records(log.path) if isinstance(record, Chunk)}
    assert found == {"" if compression == "none" else compression}


def test_a_stamp_before_the_epoch_does_not_end_the_log(tmp_path, arrive):
    message = arrive(CLOCK, 1)
    object.__setattr__(message.attachment, "stamp_ns", -5)
    log = create_log(tmp_path, "run", SETTINGS)
    log.write(message)
    log.close()
    with log.path.open("rb") as stream:
        assert [m.publish_time for _, _, m in make_reader(stream).iter_messages()] == [message.arrival_ns]


def test_topics_carry_the_namespace_as_rosbag2_has_it():
    assert channel_topic(Namespace(), "pmd/points") == "/pmd/points"
    assert channel_topic(Namespace(0, "servicer/a"), "tf") == "/servicer/a/tf"
    assert channel_topic(Namespace(0, "servicer/a"), "rosout") == "/rosout"


def _records(path: Path) -> list[object]:
    """Return the records that are on the disk now, up to where the file ends."""
    records: list[object] = []
    with path.open("rb") as stream, suppress(EndOfFile, InvalidMagic):  # where it was not closed
        for record in StreamReader(stream, emit_chunks=True).records:
            records.append(record)  # noqa: PERF402 - keeps what came before the end
    return records
