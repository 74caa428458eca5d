"""The recorder without a bus: files, counts, commands, and a disk that fails."""

import json
import threading
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from errno import EIO
from pathlib import Path

import pytest
from facility_process import until
from logger_desk import Desk, completeness, counts, metadata, read

from rpod_logger import latched, recorder, recording
from rpod_logger.errors import AlreadyRecordingError, CannotWriteError, NotRecordingError
from rpod_logger.writer import LogFile
from rpod_runtime.delivery.accounting import DuplicateError, JumpError
from rpod_schemas.control import StatusReply
from rpod_schemas.errors import Reason
from rpod_schemas.logs import PUBLISHERS, Completeness, Numbers, TopicCount
from rpod_schemas.topics import CLOCK, TF_STATIC, Topic
from rpod_schemas.types import Health
from rpod_security.log_verification import verify

BIG = Topic("lab/big", "")


def test_counts_tell_what_was_received_written_missed_and_doubled(desk, arrive):
    one = desk()
    one.recorder.start()
    for number in (1, 2, 5, 6):
        one.put(arrive(CLOCK, number))
    with pytest.raises(DuplicateError):
        one.account.take(arrive(CLOCK, 6).key, arrive(CLOCK, 6).attachment)
    closed = one.recorder.stop()
    assert counts(closed.path) == {"/clock": TopicCount(received=4, written=4, missed=2, duplicates=1)}
    assert closed.messages == len(read(closed.path)) == 4


def test_a_file_that_lacks_nothing_says_so_and_what_it_continues(desk, arrive):
    one = desk()
    first = one.recorder.start()
    one.put(arrive(CLOCK, 1))
    second = one.recorder.split()
    one.put(arrive(CLOCK, 2))
    one.recorder.stop()
    third = one.recorder.start()
    one.put(arrive(CLOCK, 4))
    one.recorder.stop()
    assert completeness(first.path) == Completeness(complete=True)
    assert completeness(second.path) == Completeness(complete=True, continues="run.mcap")
    assert completeness(third.path) == Completeness(complete=False, reasons=("/clock: 1 missed on the bus",))


def test_what_was_recovered_and_what_was_rejected_is_told(desk, arrive):
    one = desk()
    log = one.recorder.start()
    for number, fetched in ((1, False), (2, True)):
        message = arrive(CLOCK, number)
        one.account.take(message.key, message.attachment, fetched=fetched)
        one.recorder.put(message)
    one.health.reject("pmd/info", Reason.MALFORMED)
    one.health.reject("pmd/info", Reason.DUPLICATE)
    one.recorder.stop()
    assert counts(log.path) == {
        "/clock": TopicCount(received=2, written=2, recovered=1),
        "/pmd/info": TopicCount(rejected=1),
    }
    assert completeness(log.path).reasons == ("/pmd/info: 1 rejected",)


def test_latched_messages_of_publishers_without_end_are_bounded(desk, arrive, monkeypatch, caplog):
    monkeypatch.setattr(latched, "MOST_MESSAGES", 3)
    one = desk()
    one.recorder.start()
    for number in range(5):
        one.put(arrive(TF_STATIC, 1, gid=bytes([number] * 16)))
    second = one.recorder.split()
    one.recorder.stop()
    assert len(read(second.path)) == 3
    assert one.counter("latched/forgotten") == 2
    assert caplog.text.count("more than 3 latched messages") == 1


def test_latched_messages_are_bounded_in_bytes_too(desk, arrive, monkeypatch, caplog):
    monkeypatch.setattr(latched, "MOST_BYTES", 1000)
    one = desk()
    one.recorder.start()
    for number in range(5):
        one.put(arrive(TF_STATIC, 1, payload=bytes(400), gid=bytes([number] * 16)))
    second = one.recorder.split()
    one.recorder.stop()
    assert len(read(second.path)) == 2
    assert one.counter("latched/forgotten") == 3
    assert caplog.text.count("the next file begins without the rest") == 1


def test_publishers_without_end_are_written_but_not_all_listed(desk, arrive, monkeypatch):
    monkeypatch.setattr(recording, "_MOST_RUNS", 3)
    one = desk()
    log = one.recorder.start()
    for number in range(5):
        one.put(arrive(CLOCK, 1, gid=bytes([number] * 16)))
    one.recorder.stop()
    assert len(read(log.path)) == 5
    assert counts(log.path)["/clock"] == TopicCount(received=5, written=5)
    (reason,) = completeness(log.path).reasons
    assert reason == "more than 3 publishers, or jumps of them: not all are listed"


def test_a_publisher_that_jumps_without_end_is_not_listed_without_end(desk, arrive, monkeypatch):
    monkeypatch.setattr(recording, "_MOST_RUNS", 3)
    one = desk()
    log = one.recorder.start()
    starts = [10_000 * jump for jump in range(1, 8)]
    for number in (start + step for start in starts for step in range(3)):
        with suppress(JumpError):
            one.put(arrive(CLOCK, number))
    one.recorder.stop()
    assert len(numbers(log.path)["/clock"]) == 3
    assert counts(log.path)["/clock"].written == len(read(log.path)) == 3 + 6
    assert not completeness(log.path).complete


def test_sequence_numbers_can_be_counted_again_by_publisher(desk, arrive):
    one, restarted = desk(), b"r" * 16
    log = one.recorder.start()
    one.put(arrive(TF_STATIC, 1))
    for number in (1, 2, 5):
        one.put(arrive(CLOCK, number))
        one.put(arrive(CLOCK, number + 10, gid=restarted))
    second = one.recorder.split()
    one.put(arrive(CLOCK, 16, gid=restarted))
    one.put(arrive(Topic("lab/raw", ""), 0))
    one.recorder.stop()
    kept = [numbers(log.path), numbers(second.path)]
    key, gid = arrive(CLOCK, 1).key, (b"g" * 16).hex()
    assert kept[0]["/clock"] == [
        Numbers(key=key, gid=gid, first=1, last=5, messages=3),
        Numbers(key=key, gid=restarted.hex(), first=11, last=15, messages=3),
    ]
    assert kept[1] == {"/clock": [Numbers(key=key, gid=restarted.hex(), first=16, last=16, messages=1)]}
    there = Counter(number for topic, number in read(log.path) if topic == "/clock")
    ought = Counter(n for each in kept[0]["/clock"] for n in range(each.first, each.last + 1))
    assert ought - there == Counter((3, 4, 13, 14))
    assert counts(log.path)["/clock"].missed == 4


def test_a_publisher_that_begins_at_0_is_counted_like_any_other(desk, arrive):
    one = desk()
    log = one.recorder.start()
    for number in (0, 1, 2):
        one.put(arrive(CLOCK, number))
    one.recorder.stop()
    assert completeness(log.path) == Completeness(complete=True)
    key, gid = arrive(CLOCK, 1).key, (b"g" * 16).hex()
    assert numbers(log.path)["/clock"] == [Numbers(key=key, gid=gid, first=0, last=2, messages=3)]


def test_numbers_that_jump_are_refused_told_and_make_a_log_incomplete_that_holds_all_others(desk, arrive):
    one = desk()
    log = one.recorder.start()
    for number in (1, 2, 2**40, 3, 4):
        with suppress(JumpError):
            one.put(arrive(CLOCK, number))
            continue
        one.health.reject(CLOCK.name, Reason.JUMP)
    one.recorder.stop()
    assert [number for _, number in read(log.path)] == [1, 2, 3, 4]
    assert counts(log.path)["/clock"] == TopicCount(received=4, written=4, rejected=1)
    assert completeness(log.path).reasons == ("/clock: 1 rejected",)


def test_a_publisher_that_truly_jumped_stands_in_the_record_once_a_run_of_numbers(desk, arrive):
    one = desk()
    log = one.recorder.start()
    for number in (1, 2, 3, 5001, 5002, 5003, 5004):
        with suppress(JumpError):
            one.put(arrive(CLOCK, number))
            continue
        one.health.reject(CLOCK.name, Reason.JUMP)
    one.recorder.stop()
    runs = numbers(log.path)["/clock"]
    assert [(run.first, run.last, run.messages) for run in runs] == [(1, 3, 3), (5003, 5004, 2)]
    assert counts(log.path)["/clock"] == TopicCount(received=5, written=5, missed=4997, rejected=2)


def numbers(path: str) -> dict[str, list[Numbers]]:
    record = metadata(path, PUBLISHERS)
    return {topic: [Numbers(**each) for each in json.loads(text)] for topic, text in record.items()}


def test_a_large_file_gives_way_to_the_next_and_nothing_is_lost_between(desk, arrive, tmp_path, monkeypatch):
    monkeypatch.setattr(recorder, "_IDLE_S", 1e-3)
    one = desk(split_bytes=1 << 16, chunk_bytes=1 << 13, compression="none")
    one.recorder.start()
    for number in range(1, 201):
        one.put(arrive(BIG, number, payload=bytes(5_000)))
        if number % 4 == 0:  # a split that is asked for comes behind what is queued
            until(lambda number=number: one.counter("written/lab/big") == number)
    one.recorder.stop()
    paths = sorted(tmp_path.iterdir())
    assert len(paths) >= 10
    assert [number for path in paths for _, number in read(path)] == list(range(1, 201))
    assert all(path.stat().st_size < 90_000 for path in paths)
    said = [completeness(path) for path in paths]
    assert all(record.complete for record in said)
    assert [record.continues for record in said] == [None, *(path.name for path in paths[:-1])]


def test_an_old_file_gives_way_to_the_next(desk, arrive, tmp_path):
    one = desk(split_interval_s=0.05)
    one.recorder.start()
    number = 0
    while len(list(tmp_path.iterdir())) < 3:
        number += 1
        one.put(arrive(CLOCK, number))
        until(lambda number=number: one.counter("written/clock") == number)
    one.recorder.stop()
    paths = sorted(tmp_path.iterdir())
    assert [sequence for path in paths for _, sequence in read(path)] == list(range(1, number + 1))


def test_a_clock_that_jumps_is_told_and_nothing_is_lost(desk, arrive, caplog):
    one = desk()
    log = one.recorder.start()
    for number, jump_s in ((1, 0), (2, 0), (3, -3600), (4, -3600)):
        message = arrive(CLOCK, number)
        at_s = message.arrival_ns * 1e-9  # so that both clocks agree but for the jump
        one.put(replace(message, arrival_s=at_s, arrival_ns=message.arrival_ns + jump_s * 10**9))
    one.recorder.stop()
    assert read(log.path) == [("/clock", number) for number in (1, 2, 3, 4)]
    assert completeness(log.path) == Completeness(complete=True, clock_jumps_s=(-3600.0,))
    assert one.counter("clock/jumps") == 1
    assert "jumped by -3600.000 s" in caplog.text


def test_a_split_to_a_name_that_the_disk_refuses_is_told_and_goes_on_under_the_old_one(desk, arrive):
    one = desk()
    one.recorder.start()
    one.put(arrive(CLOCK, 1))
    with pytest.raises(CannotWriteError, match="name too long"):
        one.recorder.split("x" * 300)
    one.put(arrive(CLOCK, 2))
    closed = one.recorder.stop()
    assert Path(closed.path).name == "run_0002.mcap"
    assert len(read(closed.path)) == 1
    assert completeness(closed.path) == Completeness(complete=True, continues="run.mcap")


def test_a_split_loses_and_doubles_nothing_and_counts_each_file_for_itself(desk, arrive):
    one = desk()
    first = one.recorder.start()
    for number in range(1, 8):
        one.put(arrive(CLOCK, number))
    second = one.recorder.split()
    for number in range(8, 12):
        one.put(arrive(CLOCK, number))
    one.recorder.stop()
    assert Path(second.path).name == "run_0002.mcap"
    assert read(first.path) == [("/clock", number) for number in range(1, 8)]
    assert read(second.path) == [("/clock", number) for number in range(8, 12)]
    assert [counts(log.path)["/clock"].received for log in (first, second)] == [7, 4]


def test_every_file_opens_with_the_last_latched_message_of_each_publisher(desk, arrive):
    one = desk()
    one.recorder.start()
    one.put(arrive(TF_STATIC, 1))
    one.put(arrive(TF_STATIC, 2))
    one.put(arrive(TF_STATIC, 1, gid=b"h" * 16))
    one.put(arrive(CLOCK, 1))
    second = one.recorder.split("later")
    one.put(arrive(CLOCK, 2))
    one.recorder.stop()
    assert read(second.path) == [("/tf_static", 2), ("/tf_static", 1), ("/clock", 2)]
    assert counts(second.path)["/tf_static"] == TopicCount(repeated=2)


def test_what_came_while_nothing_was_recorded_is_in_no_file_but_its_latched_messages_are(desk, arrive):
    one = desk()
    one.put(arrive(TF_STATIC, 1))
    one.put(arrive(CLOCK, 1))
    log = one.recorder.start()
    one.put(arrive(CLOCK, 2))
    one.recorder.stop()
    assert read(log.path) == [("/tf_static", 1), ("/clock", 2)]
    assert counts(log.path)["/clock"] == TopicCount(received=1, written=1)


def test_what_does_not_fit_is_lost_loudly_and_counted(desk, arrive, monkeypatch, caplog):
    disk_is_free = threading.Event()
    write = LogFile.write

    def write_late(self, received):
        assert disk_is_free.wait(10)
        write(self, received)

    monkeypatch.setattr(LogFile, "write", write_late)
    one = desk(queue_bytes=1 << 20)
    log = one.recorder.start()
    for number in range(1, 41):
        one.put(arrive(BIG, number, payload=bytes(100_000)))
    one.recorder.log_losses()
    level, message = one.recorder.check()
    disk_is_free.set()
    closed = one.recorder.stop()
    count = counts(log.path)["/lab/big"]
    assert count.received == 40
    assert 10 <= count.written == closed.messages <= 12  # the queue's, and one in the writer's hands
    assert one.health.counters()["lost/lab/big"] == count.lost == 40 - count.written
    assert level is Health.ERROR
    assert f"{count.lost} lost here" in message
    assert [record.levelname for record in caplog.records] == ["ERROR"]
    assert 900_000 < one.health.counters()["queue/high_water_bytes"] <= 1 << 20


def test_a_failing_close_is_told_to_who_asked(desk, arrive, monkeypatch):
    def fail(_):
        raise OSError(EIO, "Input/output error")

    monkeypatch.setattr(LogFile, "close", fail)
    one = desk()
    one.recorder.start()
    one.put(arrive(CLOCK, 1))
    with pytest.raises(CannotWriteError, match="Input/output error"):
        one.recorder.stop()


def test_the_log_is_finished_when_the_recorder_ends(tmp_path, arrive):
    desk = Desk(tmp_path)
    with desk.recorder:
        log = desk.recorder.start()
        for number in range(1, 101):
            desk.put(arrive(CLOCK, number))
    assert len(read(log.path)) == 100
    assert counts(log.path)["/clock"].written == 100
    with pytest.raises(NotRecordingError):
        desk.recorder.stop()


def test_start_is_refused_while_recording_and_stop_while_not(desk):
    one = desk()
    one.recorder.start()
    with pytest.raises(AlreadyRecordingError, match="use split"):
        one.recorder.start()
    one.recorder.stop()
    with pytest.raises(NotRecordingError):
        one.recorder.stop()


def test_a_directory_that_cannot_be_made_is_told_to_who_asked(desk, tmp_path):
    one = desk()
    (tmp_path / "file").touch()
    blocked = Desk(tmp_path / "file" / "below")
    with blocked.recorder, pytest.raises(CannotWriteError, match="below"):
        blocked.recorder.start()
    assert one.recorder.check() == (Health.OK, "not recording")


def test_configuration_software_and_target_of_the_services_are_in_the_log(desk):
    one = desk()
    log = one.recorder.start()
    one.recorder.know([status("emulator", seed=1), status("motion", rate_hz=250.0)])
    one.recorder.know([status("emulator", seed=2)])
    one.recorder.stop()
    configuration = metadata(log.path, "configuration")
    assert json.loads(configuration["emulator"]) == {"seed": 2}
    assert json.loads(configuration["motion"]) == {"rate_hz": 250.0}
    assert metadata(log.path, "software") == {
        "name": "rpod",
        "version": "1.2.3",
        "target_digest": "abc",
        "target_content": "def",
    }
    assert json.loads(metadata(log.path, "status")["emulator"])["counters"] == {"frames": 3}


def status(name: str, **configuration: object) -> StatusReply:
    return StatusReply(
        name=name,
        version="1.2.3",
        state="ready",
        uptime_s=1.0,
        counters={"frames": 3},
        configuration=configuration,
        target_digest="abc" if name == "emulator" else None,
        target_content="def" if name == "emulator" else None,
    )


def test_a_log_and_its_successor_have_digest_chains_that_fit_them(desk, arrive):
    one = desk(digest_chain=True)
    first = one.recorder.start()
    one.put(arrive(CLOCK, 1))
    second = one.recorder.split()
    one.put(arrive(CLOCK, 2))
    one.recorder.stop()
    for log in (first, second):
        result = verify(Path(log.path))
        assert (result.problems, result.closed) == ([], True)
        assert result.verified_bytes == Path(log.path).stat().st_size
