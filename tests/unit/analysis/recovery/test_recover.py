"""Logs cut at hundreds of places, flipped, overwritten: what is whole comes back, and nothing else."""

import json
from io import BytesIO
from itertools import pairwise

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from synthetic_log import SyntheticRun

from rpod_analysis import AnalysisError, open_log, read_run
from rpod_analysis.errors import NothingRecoveredError
from rpod_analysis.recovery import recover
from rpod_analysis.recovery.recover import _Account
from rpod_schemas.logs import RECOVERY, Recovery

TOPICS = ("/truth/odometry", "/estimate/odometry", "/pmd/depth/image_raw")
COMPRESSIONS = [CompressionType.LZ4, CompressionType.ZSTD, CompressionType.NONE]


def write_log(compression=CompressionType.LZ4, *, messages=120, seed=1, **options):
    """Return a log of three topics in small chunks, with a metadata record at either end."""
    random, stream = np.random.default_rng(seed), BytesIO()
    writer = Writer(stream, chunk_size=2048, compression=compression, **options)
    writer.start(profile="ros2", library="test")
    writer.add_metadata("first", {"a": "1"})
    schema = writer.register_schema("test/msg/Some", "ros2msg", b"float64 x")
    channels = [writer.register_channel(topic, "cdr", schema, {"k": "v"}) for topic in TOPICS]
    for number in range(messages):
        writer.add_message(
            channels[number % 3],
            log_time=1000 + number,
            publish_time=number,
            sequence=number // 3 + 1,
            data=random.integers(0, 40, int(random.integers(20, 200)), np.uint8).tobytes(),
        )
    writer.add_metadata("last", {"b": "2"})
    writer.finish()
    return stream.getvalue()


def messages_in(data):
    reader = make_reader(BytesIO(data), validate_crcs=True)
    return [
        (channel.topic, channel.metadata, schema.data, message.log_time, message.sequence, message.data)
        for schema, channel, message in reader.iter_messages()
    ]


def chunks_of(data):
    """Return beginning, end, and number of messages of each chunk."""
    reader = make_reader(BytesIO(data))
    indexes = sorted(reader.get_summary().chunk_indexes, key=lambda index: index.chunk_start_offset)
    ends = [index.message_end_time - index.message_start_time + 1 for index in indexes]
    return [
        (index.chunk_start_offset, index.chunk_start_offset + index.chunk_length, count)
        for index, count in zip(indexes, ends, strict=True)
    ]


@pytest.fixture(params=COMPRESSIONS, ids=lambda item: item.name.lower())
def data(request):
    return write_log(request.param)


@pytest.fixture
def recovered(tmp_path):
    """Recovers bytes: returns the account and the messages of the new file."""

    def run(damaged):
        source, out = tmp_path / "damaged.mcap", tmp_path / "recovered.mcap"
        source.write_bytes(damaged)
        out.unlink(missing_ok=True)
        try:
            recovery = recover(source, out)
        except NothingRecoveredError as error:
            assert not out.exists(), "an empty log is none"
            return error.recovery, []
        assert source.read_bytes() == damaged, "the original is never touched"
        found = messages_in(out.read_bytes())
        assert recovery.messages == len(found)
        return recovery, found

    return run


def test_a_whole_log_comes_back_whole(data, recovered):
    recovery, found = recovered(data)
    assert recovery.whole
    assert found == messages_in(data)
    assert all(topic.lost == 0 for topic in recovery.topics.values())


def test_a_cut_at_any_byte_leaves_every_message_before_it(data, recovered):
    """Every byte of the header, of a chunk with its indexes, of the end; and a hundred cuts at random."""
    whole, chunks = messages_in(data), chunks_of(data)
    begin, end = chunks[len(chunks) // 2][0], chunks[len(chunks) // 2 + 1][0]
    step = 9 if end - begin > 1000 else 5
    cuts = {*range(8, 90, 3), *range(begin, end, step), *range(len(data) - 60, len(data), 2)}
    cuts |= set(np.random.default_rng(3).integers(8, len(data), 100).tolist())
    before = 0
    for cut in sorted(cuts):
        recovery, found = recovered(data[:cut])
        assert found == whole[: len(found)], cut
        assert len(found) >= sum(count for _, chunk_end, count in chunks if chunk_end <= cut), cut
        assert len(found) >= before, "a longer file never holds less"
        assert recovery.closed == (cut >= len(data) - 8), "all but the file's last eight bytes"
        before = len(found)


def test_flipped_bits_cost_the_chunk_that_they_are_in_and_the_loss_is_counted(data, recovered):
    whole, chunks = messages_in(data), chunks_of(data)
    random = np.random.default_rng(4)
    for place in random.integers(8, len(data), 80):
        flipped = bytearray(data)
        flipped[place] ^= 1 << int(random.integers(8))
        recovery, found = recovered(bytes(flipped))
        hit = [count for begin, end, count in chunks if begin <= place < end]
        kept = iter(whole)
        assert all(message in kept for message in found), "whole messages only, in their order"
        assert len(whole) - len(found) in (0, *hit), place
        assert sum(topic.lost for topic in recovery.topics.values()) == len(whole) - len(found)


def test_garbage_in_the_middle_is_stepped_over(data, recovered):
    whole, chunks = messages_in(data), chunks_of(data)
    random = np.random.default_rng(5)
    for _ in range(40):
        first, last = sorted(random.integers(40, chunks[-1][0], 2))
        damaged = bytearray(data)
        damaged[first:last] = random.bytes(last - first)
        recovery, found = recovered(bytes(damaged))
        untouched = sum(count for begin, end, count in chunks if end <= first or begin >= last)
        kept = iter(whole)
        assert all(message in kept for message in found)
        assert len(found) >= untouched, (first, last)
        assert recovery.unreadable_bytes or last - first < 20


@pytest.mark.parametrize("inserted", [b"\x00" * 5000, b"\x06" * 5000, bytes(range(256)) * 20])
def test_bytes_that_were_put_in_between_records_do_no_harm(data, recovered, inserted):
    place = chunks_of(data)[3][0]
    recovery, found = recovered(data[:place] + inserted + data[place:])
    assert found == messages_in(data)
    assert recovery.unreadable_bytes == len(inserted)


def test_without_the_end_the_loss_is_told_by_sequence_numbers_and_indexes(data, recovered):
    chunks = chunks_of(data)
    begin, end, count = chunks[2]
    damaged = bytearray(data[: chunks[-1][1]])
    damaged[end - 10] ^= 1
    recovery, found = recovered(bytes(damaged))
    assert sum(topic.lost for topic in recovery.topics.values()) == count
    assert len(found) == sum(number for _, _, number in chunks) - count
    assert begin < end


def test_channels_whose_first_chunk_is_damaged_are_still_known(recovered):
    """The definitions stand at the first chunk's beginning: the summary has them too, or they are read."""
    data = write_log(CompressionType.NONE)
    _, end, count = chunks_of(data)[0]
    damaged = bytearray(data)
    damaged[end - 5] ^= 1
    for cut in (len(data), len(data) - 50):
        recovery, found = recovered(bytes(damaged[:cut]))
        assert len(found) == 120 - count
        assert not recovery.without_definition


def test_messages_whose_channel_is_lost_altogether_are_counted(recovered):
    data = write_log()
    begin, end, _ = chunks_of(data)[0]
    damaged = data[:begin] + bytes(end - begin) + data[end:-50]
    recovery, found = recovered(damaged)
    assert not found
    assert recovery.without_definition > 80


def test_an_unchunked_log_is_recovered_too(recovered):
    data = write_log(use_chunking=False)
    recovery, found = recovered(data[: len(data) // 2])
    assert 40 < len(found) < 80
    assert recovery.topics[TOPICS[0]].last_ns >= 1000 + len(found) - 3


def test_metadata_before_the_damage_is_kept_and_the_recovery_is_recorded(recovered, tmp_path):
    data = write_log()
    recovery, _ = recovered(data[: len(data) // 2])
    with open_log(tmp_path / "recovered.mcap") as log:
        assert log.metadata("first") == {"a": "1"}
        assert log.metadata("last") == {}
        assert Recovery.model_validate(json.loads(log.metadata(RECOVERY)["recovery"])) == recovery


def test_a_facility_log_that_was_cut_can_be_scored_again(tmp_path):
    path = SyntheticRun().write(tmp_path / "run.mcap")
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    recovery = recover(path)
    assert recovery.out == str(tmp_path / "run.recovered.mcap")
    with open_log(recovery.out) as log:
        run = read_run(log)
        assert 5 < len(run.estimates) < 21
        assert run.errors.scored.all()


def test_nothing_is_overwritten(tmp_path):
    path = tmp_path / "run.mcap"
    path.write_bytes(write_log())
    recover(path)
    for out in (None, path):
        with pytest.raises(AnalysisError, match="already exists"):
            recover(path, out)


@pytest.mark.parametrize("content", [b"", b"text, no log", bytes(5000)])
def test_what_is_no_mcap_is_refused_and_leaves_nothing(tmp_path, content):
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with pytest.raises(AnalysisError, match="is not an MCAP log"):
        recover(path)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("size", [20, 60])
def test_where_no_message_is_found_that_is_told_and_nothing_is_written(tmp_path, size):
    path = tmp_path / "cut.mcap"
    path.write_bytes(write_log()[:size])
    with pytest.raises(NothingRecoveredError, match=f"no message can be recovered of its {size} bytes, of w"):
        recover(path)
    assert list(tmp_path.iterdir()) == [path]


def test_an_undamaged_log_without_messages_is_no_failure(tmp_path):
    path = tmp_path / "quiet.mcap"
    path.write_bytes(write_log(messages=0))
    assert recover(path).whole


def test_a_log_that_is_missing_is_named(tmp_path):
    with pytest.raises(AnalysisError, match=r"gone\.mcap: no such file"):
        recover(tmp_path / "gone.mcap")


def test_the_test_log_has_many_chunks():
    """Else the tests above would show little."""
    data = write_log()
    chunks = chunks_of(data)
    assert len(chunks) > 5
    assert all(first[1] <= second[0] for first, second in pairwise(chunks))
    assert sum(isinstance(r, Chunk) for r in StreamReader(BytesIO(data), emit_chunks=True).records) == len(
        chunks
    )


@pytest.mark.parametrize(("last_s", "lost"), [(8.0, 25), (0.5, 0)])
def test_the_end_of_a_cut_log_is_estimated_from_topics_that_went_on_until_then(last_s, lost):
    """Messages of a service's start, such as parameter events, have no rate."""
    account = _Account()
    for number, time_s in enumerate(np.linspace(0.0, last_s, 101)):
        account.take(Message(1, round(time_s * 1e9), b"", 0, number))
    assert account.cut(10_000_000_000) == lost
