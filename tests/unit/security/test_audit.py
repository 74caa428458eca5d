import errno
import json
import os
from pathlib import Path

import pytest

from rpod_security.audit import AuditRecord, check
from rpod_security.errors import AuditError


def test_a_second_writer_that_comes_later_continues_the_record(tmp_path: Path):
    file = tmp_path / "audit.jsonl"
    for _ in range(3):
        long = "\U0001f6f0" * 2000
        AuditRecord(file, "logger").add(role="operator", verb="stop", request=long, outcome=long)
    assert check(file) == 3
    assert file.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("change", ["edit", "remove", "insert", "swap"])
def test_a_changed_record_is_found_out(tmp_path: Path, change: str):
    file = tmp_path / "audit.jsonl"
    record = AuditRecord(file, "logger")
    for number in range(5):
        record.add(role="operator", verb="stop", request=str(number), outcome="accepted")
    lines = file.read_text().splitlines()
    if change == "edit":
        lines[2] = lines[2].replace("operator", "guidance")
    elif change == "remove":
        del lines[2]
    elif change == "insert":
        lines.insert(2, lines[2])
    else:
        lines[2], lines[3] = lines[3], lines[2]
    file.write_text("\n".join(lines) + "\n")
    with pytest.raises(AuditError, match=r"line [34]"):
        check(file)


def test_a_damaged_line_is_named(tmp_path: Path):
    file = tmp_path / "audit.jsonl"
    file.write_text("no json\n")
    with pytest.raises(AuditError, match="line 1 is damaged"):
        check(file)


def test_a_record_that_cannot_be_written_is_an_error(tmp_path: Path):
    record = AuditRecord(tmp_path / "audit.jsonl", "logger")
    (tmp_path / "audit.jsonl").mkdir()
    with pytest.raises(AuditError, match="cannot be written"):
        record.add(role="operator", verb="stop", request="", outcome="")


def test_a_line_that_did_not_reach_the_disk_is_not_in_the_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    record = AuditRecord(tmp_path / "audit.jsonl", "logger")
    record.add(role="operator", verb="stop", request="1", outcome="accepted")

    def fail(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr(os, "fsync", fail)
        with pytest.raises(AuditError, match="No space left"):
            record.add(role="operator", verb="stop", request="2", outcome="accepted")
    record.add(role="operator", verb="stop", request="3", outcome="accepted")
    assert check(tmp_path / "audit.jsonl") == 2


def test_a_line_that_a_power_failure_cut_does_not_take_the_next_one_with_it(tmp_path: Path):
    file = tmp_path / "audit.jsonl"
    record = AuditRecord(file, "logger")
    for number in (1, 2):
        record.add(role="operator", verb="stop", request=str(number), outcome="accepted")
    file.write_bytes(file.read_bytes()[:-20])
    later = AuditRecord(file, "logger")
    for number in (3, 4):
        later.add(role="operator", verb="stop", request=str(number), outcome="accepted")
    lines = file.read_bytes().splitlines()
    assert [json.loads(lines[at])["request"] for at in (0, 2, 3)] == ["1", "3", "4"]
    with pytest.raises(AuditError, match="line 2 is damaged"):
        check(file)


def test_a_record_that_is_nested_without_end_is_one_line(tmp_path: Path):
    file = tmp_path / "audit.jsonl"
    file.write_text("[" * 100_000 + "\n")
    with pytest.raises(AuditError, match="line 1 is damaged"):
        check(file)
