"""What a disk can do to a log: whatever it is, it is told, and recording goes on by query."""

import errno
from pathlib import Path

import numpy as np
import pytest
from facility_process import until
from logger_desk import Desk, completeness, counts, early_metadata, read, readable
from small_disk import small_disk

from rpod_logger import recorder
from rpod_logger.errors import CannotWriteError
from rpod_logger.writer import LogFile
from rpod_schemas.topics import CLOCK, TF_STATIC, Topic
from rpod_schemas.types import Health

RAW = Topic("lab/raw", "")
MEBI = 1 << 20
SMALL = {"chunk_bytes": 1 << 15, "reserve_bytes": 1 << 18, "compression": "none"}


def feed(desk: Desk, arrive, first: int, last: int, size: int = 20_000) -> None:
    """Put numbered messages, and wait until each is in a file or lost."""
    for number in range(first, last + 1):
        desk.put(arrive(RAW, number, payload=bytes(size)))
        until(lambda number=number: done(desk) == number)


def done(desk: Desk) -> int:
    return desk.counter("written/lab/raw") + desk.counter("lost/lab/raw")


def test_on_a_full_disk_the_file_is_closed_and_the_next_one_starts_when_there_is_room(
    desk, arrive, tmp_path, caplog, monkeypatch
):
    monkeypatch.setattr(recorder, "_IDLE_S", 1e-3)
    with small_disk(tmp_path / "disk", 4 * MEBI) as disk:
        one = desk(disk.path, **SMALL)
        first = one.recorder.start()
        one.put(arrive(TF_STATIC, 1))
        feed(one, arrive, 1, 10)
        ballast = disk.fill(leave_bytes=MEBI)
        feed(one, arrive, 11, 100)
        level, message = one.recorder.check()
        ballast.unlink()
        second = one.recorder.start()
        feed(one, arrive, 101, 110)
        one.recorder.stop()
        kept = [number for topic, number in read(first.path) if topic == "/lab/raw"]
        assert 40 < len(kept) < 100
        assert kept == list(range(1, len(kept) + 1))
        assert one.counter("lost/lab/raw") == 100 - len(kept)
        assert completeness(first.path).reasons[0] == "the disk is full"
        assert not completeness(first.path).complete
        assert counts(first.path)["/lab/raw"].written == len(kept)
        assert read(second.path)[0] == ("/tf_static", 1)
        assert [number for _, number in read(second.path)[1:]] == list(range(101, 111))
        assert completeness(second.path).continues is None
    assert level is Health.ERROR
    assert (
        f"cannot write {first.path}: the disk is full; the file is closed and readable; free space" in message
    )
    assert f"{100 - len(kept)} lost here" in message
    assert [record.levelname for record in caplog.records] == ["ERROR"]


def test_where_not_even_the_end_fits_the_file_ends_behind_a_whole_record(desk, arrive, tmp_path):
    with small_disk(tmp_path / "disk", 4 * MEBI) as disk:
        one = desk(disk.path, **SMALL)
        log = one.recorder.start()
        feed(one, arrive, 1, 10)
        disk.fill()
        feed(one, arrive, 11, 12, size=MEBI)  # a message larger than the reserve
        kept = readable(Path(log.path))
        assert kept == list(range(1, len(kept) + 1))
        assert len(kept) == one.counter("written/lab/raw") == 12 - one.counter("lost/lab/raw")
        assert early_metadata(Path(log.path), "software")["version"] == "1.2.3"
    assert "'rpod recover' makes it readable; free space" in one.recorder.check()[1]


def test_the_log_of_a_disk_that_is_full_from_the_start_is_refused_and_can_be_started_later(
    desk, arrive, tmp_path
):
    with small_disk(tmp_path / "disk", 4 * MEBI) as disk:
        ballast = disk.fill(leave_bytes=1 << 17)
        one = desk(disk.path, **SMALL)
        with pytest.raises(CannotWriteError, match="No space left on device; free space on the disk"):
            one.recorder.start()
        feed(one, arrive, 1, 3)
        assert one.counter("lost/lab/raw") == 3
        assert one.recorder.check()[0] is Health.ERROR
        ballast.unlink()
        log = one.recorder.start()
        feed(one, arrive, 4, 5)
        one.recorder.stop()
        assert read(log.path) == [("/lab/raw", 4), ("/lab/raw", 5)]
        assert sorted(path.name for path in disk.path.iterdir()) == ["run.mcap"]


def test_a_read_only_directory_is_told_and_recording_starts_when_it_can_be_written(desk, arrive, tmp_path):
    with small_disk(tmp_path / "disk", MEBI) as disk:
        disk.remount("ro")
        one = desk(disk.path, **SMALL)
        with pytest.raises(CannotWriteError, match="Read-only file system; make the folder writable"):
            one.recorder.start()
        disk.remount("rw")
        log = one.recorder.start()
        feed(one, arrive, 1, 2)
        one.recorder.stop()
        assert read(log.path) == [("/lab/raw", 1), ("/lab/raw", 2)]


def test_a_vanished_mount_is_told_within_a_sync(desk, arrive, tmp_path):
    with small_disk(tmp_path / "disk", 4 * MEBI) as disk:
        one = desk(disk.path, sync_interval_s=0.05, **SMALL)
        one.recorder.start()
        feed(one, arrive, 1, 2)
        disk.vanish()
        until(lambda: one.recorder.check()[0] is Health.ERROR)
        feed(one, arrive, 3, 4)
    assert "vanished from its directory" in one.recorder.check()[1]
    assert "check the disk and its mount, then use start" in one.recorder.check()[1]
    assert one.counter("lost/lab/raw") == 2


def test_a_log_that_somebody_deletes_is_told_and_a_new_one_can_be_started(desk, arrive):
    one = desk(sync_interval_s=0.05, **SMALL)
    log = one.recorder.start()
    feed(one, arrive, 1, 2)
    Path(log.path).unlink()
    until(lambda: one.recorder.check()[0] is Health.ERROR)
    second = one.recorder.start()
    feed(one, arrive, 3, 3)
    one.recorder.stop()
    assert read(second.path) == [("/lab/raw", 3)]


def test_a_disk_that_breaks_costs_the_open_chunk_and_what_follows(desk, arrive, monkeypatch, caplog):
    one = desk()
    first = one.recorder.start()
    feed(one, arrive, 1, 3)
    write = LogFile.write

    def broken(self, received):
        if received.attachment.sequence in (4, 5):
            raise OSError(errno.EIO, "Input/output error")
        write(self, received)

    monkeypatch.setattr(LogFile, "write", broken)
    feed(one, arrive, 4, 5)
    assert one.recorder.check()[1].startswith(
        f"cannot write {first.path}: Input/output error; the file could not"
    )
    assert one.counter("lost/lab/raw") == 2 + 3
    second = one.recorder.start()
    feed(one, arrive, 6, 6)
    one.recorder.stop()
    assert read(second.path) == [("/lab/raw", 6)]
    assert one.recorder.check() == (Health.ERROR, "not recording; 5 lost here, 0 missed on the bus")
    assert [record.levelname for record in caplog.records] == ["ERROR"]


def test_a_log_cut_at_any_byte_holds_all_that_was_synced_before(desk, arrive, tmp_path):
    one = desk(chunk_bytes=1 << 14, reserve_bytes=1 << 16)
    log = Path(one.recorder.start().path)
    generator = np.random.default_rng(5)
    synced = [(0, 0)]  # size of the file, messages in it
    number = 0
    for _ in range(25):
        for size in generator.integers(1, 4_000, size=int(generator.integers(1, 12))):
            number += 1
            one.put(arrive(RAW, number, payload=generator.bytes(int(size))))
        one.recorder._run_in_writer(lambda _: one.recorder._sync())
        synced.append((log.stat().st_size, number))
    one.recorder.stop()
    whole = log.read_bytes()
    cut_log = tmp_path / "cut"
    for cut in sorted(generator.choice(len(whole), 400, replace=False)):
        cut_log.write_bytes(whole[:cut])
        numbers = readable(cut_log)
        assert numbers == list(range(1, len(numbers) + 1)), cut
        assert len(numbers) >= max(messages for size, messages in synced if size <= cut), cut


def test_a_jump_of_the_clock_before_the_epoch_does_not_end_the_log(desk, arrive):
    one = desk()
    log = one.recorder.start()
    message = arrive(CLOCK, 1)
    object.__setattr__(message, "arrival_ns", -5)
    one.put(message)
    one.recorder.stop()
    assert read(log.path) == [("/clock", 1)]
