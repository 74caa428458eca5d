"""The file under a log: all or nothing of every write, and room for the end."""

import errno
import os
import resource
from contextlib import contextmanager

import pytest
from small_disk import small_disk

from rpod_logger.disk import DiskFile

MEBI = 1 << 20


@contextmanager
def limited_file_size(size: int):
    """Let no file of this process grow beyond a size."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_write_that_fails_leaves_no_trace(tmp_path):
    file = DiskFile(tmp_path / "x", reserve_bytes=4096)
    file.write(b"a" * 10_000)
    with limited_file_size(15_000), pytest.raises(OSError, match="File too large") as raised:
        file.write(b"b" * 10_000)
    file.close()
    assert raised.value.errno == errno.EFBIG
    assert (tmp_path / "x").read_bytes() == b"a" * 10_000
    assert file.tell() == 10_000


def test_on_a_full_disk_the_reserve_takes_what_did_not_fit(tmp_path):
    with small_disk(tmp_path / "disk", 8 * MEBI) as disk:
        file = DiskFile(disk.path / "x", reserve_bytes=MEBI)
        disk.fill()
        assert not file.full
        file.write(b"a" * (MEBI // 2))
        assert file.full
        file.write(b"b" * (MEBI // 4))
        with pytest.raises(OSError, match="No space left"):
            file.write(b"c" * MEBI)
        file.close()
        assert (disk.path / "x").stat().st_size == MEBI * 3 // 4


def test_no_file_is_made_where_there_is_no_room_for_its_end(tmp_path):
    with small_disk(tmp_path / "disk", 4 * MEBI) as disk:
        disk.fill(leave_bytes=MEBI // 2)
        with pytest.raises(OSError, match="No space left"):
            DiskFile(disk.path / "x", reserve_bytes=MEBI)
        assert [path.name for path in disk.path.iterdir()] == ["ballast"]


def test_the_reserve_has_no_name_and_ends_with_the_file(tmp_path):
    file = DiskFile(tmp_path / "x", reserve_bytes=MEBI)
    assert os.listdir(tmp_path) == ["x"]  # noqa: PTH208 - names alone
    file.close()


def test_a_file_that_is_moved_or_replaced_has_vanished(tmp_path):
    file = DiskFile(tmp_path / "x", reserve_bytes=4096)
    assert not file.vanished
    (tmp_path / "x").rename(tmp_path / "y")
    assert file.vanished
    (tmp_path / "x").touch()
    assert file.vanished
    file.close()


def test_an_existing_file_is_not_touched_and_nothing_stays_open(tmp_path):
    (tmp_path / "x").write_bytes(b"precious")
    with pytest.raises(FileExistsError):
        DiskFile(tmp_path / "x", reserve_bytes=4096)
    assert (tmp_path / "x").read_bytes() == b"precious"
