"""What logs say of their own completeness, and what contradicts it."""

import json

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from synthetic_log import SyntheticRun

from rpod_analysis import open_log
from rpod_analysis.log.completeness import check_log_completeness
from rpod_analysis.recovery import recover
from rpod_schemas.errors import Reason
from rpod_schemas.logs import BUS, COMPLETENESS, COUNTS, PUBLISHERS, Numbers


def statement_of(*paths):
    with open_log(*paths) as log:
        return check_log_completeness(log)


def with_records(path, **records):
    """Write a log's messages again, with other metadata records."""
    out = path.with_name("changed.mcap")
    with path.open("rb") as source, out.open("wb") as stream:
        reader, writer = make_reader(source), Writer(stream)
        writer.start(profile="ros2")
        channels = {}
        for schema, channel, message in reader.iter_messages():
            if channel.topic not in channels:
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(
                    channel.topic, channel.message_encoding, known
                )
            writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
        for item in reader.iter_metadata():
            writer.add_metadata(item.name, records.get(item.name, item.metadata))
        if PUBLISHERS in records:
            writer.add_metadata(PUBLISHERS, records[PUBLISHERS])
        if BUS in records:
            writer.add_metadata(BUS, records[BUS])
        writer.finish()
    return out


@pytest.fixture
def whole(tmp_path):
    return SyntheticRun().write(tmp_path / "run.mcap")


def test_a_log_that_calls_itself_complete_and_is_so_is_believed(whole):
    said = statement_of(whole)
    assert (said.complete, said.reasons) == (True, ())


def test_a_log_with_missed_messages_says_which(tmp_path):
    said = statement_of(SyntheticRun(unlogged=2).write(tmp_path / "run.mcap"))
    assert said.complete is False
    assert said.reasons == ("/pmd/depth/image_raw: 2 missed on the bus",)


def test_a_log_that_says_nothing_is_neither(tmp_path):
    said = statement_of(SyntheticRun(states_completeness=False).write(tmp_path / "run.mcap"))
    assert (said.complete, said.reasons) == (None, ())


def test_a_statement_that_the_content_contradicts_is_not_believed(whole):
    with open_log(whole) as log:
        counts = log.files[0].metadata(COUNTS)
    count = json.loads(counts["/estimate/status"])
    counts["/estimate/status"] = json.dumps(count | {"received": 30, "written": 30})
    said = statement_of(with_records(whole, **{COUNTS: counts}))
    assert said.complete is False
    assert said.reasons == ("/estimate/status: 21 in the file, 30 by its account",)


@pytest.mark.parametrize(
    ("last", "messages", "reason"),
    [
        (21, 21, None),
        (25, 21, "4 missing in its publishers' numbers, 0 by the logger's count"),
        (20, 20, "20 written by its publishers' numbers, 21 by the logger's count"),
    ],
)
def test_the_publishers_numbers_are_counted_again(whole, last, messages, reason):
    numbers = Numbers(key="0/estimate/status", gid="00", first=1, last=last, messages=messages)
    record = {"/estimate/status": json.dumps([numbers.model_dump()])}
    said = statement_of(with_records(whole, **{PUBLISHERS: record}))
    assert said.reasons == ((f"/estimate/status: {reason}",) if reason else ())
    assert said.complete is (reason is None)


def test_the_record_tells_how_much_was_published_before_the_log(whole):
    def numbers(gid, first):
        return {"key": "0/tf", "gid": gid, "first": first, "last": first + 9, "messages": 10}

    instances = [numbers("00", 916), numbers("01", 264), numbers("02", 1), numbers("00", 950)]
    begun = with_records(whole, **{PUBLISHERS: {"/tf": json.dumps(instances), "/pose": "[{}]"}})
    with open_log(begun) as log:
        assert log.published_before == {"tf": 915 + 263}
        assert log.unreadable.by_topic() == {PUBLISHERS: {Reason.MALFORMED: 1}}
    with open_log(whole) as log:
        assert log.published_before == {}


@pytest.mark.parametrize("text", ["perhaps", "[" * 100_000])
@pytest.mark.parametrize(("record", "field"), [(COMPLETENESS, "complete"), (BUS, "outages")])
def test_a_statement_that_cannot_be_read_counts_as_none_that_is_good(whole, record, field, text):
    with open_log(whole) as log:
        good = log.files[0].metadata(record)
    out = with_records(whole, **{record: good | {field: text}})
    said = statement_of(out)
    assert (said.complete, said.reasons) == (False, ("its record of completeness cannot be read",))


def test_a_recovered_log_tells_what_was_lost(whole):
    whole.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    said = statement_of(recover(whole).out)
    assert said.complete is False
    assert "recovered from a log that was not closed: its end is not known" in said.reasons


def test_parts_of_a_log_are_complete_where_each_goes_on_from_the_one_before(tmp_path):
    first = SyntheticRun(part=(-np.inf, 1.0)).write(tmp_path / "run.mcap")
    second = SyntheticRun(part=(1.0, np.inf), continues="run.mcap").write(tmp_path / "run_0002.mcap")
    assert statement_of(first, second).complete is True
    alone = statement_of(second)
    assert alone.complete is False
    assert alone.reasons == ("run_0002.mcap continues run.mcap, which is missing",)


def test_a_gap_between_the_parts_of_a_log_is_named(tmp_path):
    first = SyntheticRun(part=(-np.inf, 1.0)).write(tmp_path / "run.mcap")
    second = SyntheticRun(part=(1.2, np.inf)).write(tmp_path / "run_0002.mcap")
    said = statement_of(first, second)
    assert said.complete is False
    assert said.reasons == ("run_0002.mcap does not state that it continues run.mcap",)
