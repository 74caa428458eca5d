from pathlib import Path

import pytest

from rpod_runtime.bus import starts
from rpod_runtime.bus.starts import next_start


@pytest.fixture(autouse=True)
def cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setenv("RPOD_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_each_start_has_the_next_number_whatever_the_clock_says(monkeypatch: pytest.MonkeyPatch) -> None:
    first = next_start("e57a7e")
    monkeypatch.setattr(starts.time, "time_ns", lambda: 0)
    assert [next_start("e57a7e") for _ in range(3)] == [first + 1, first + 2, first + 3]
    assert next_start("a1") == 0, "another client has numbers of its own"


def test_a_damaged_file_is_replaced(cache: Path) -> None:
    (cache / "starts").mkdir(parents=True)
    (cache / "starts" / "a1").write_bytes(b"\x00no number \xff")
    first = next_start("a1")
    assert next_start("a1") == first + 1


def test_a_folder_that_cannot_be_written_is_told(cache: Path, caplog: pytest.LogCaptureFixture) -> None:
    cache.touch()
    assert next_start("a1") > 0
    assert "set RPOD_CACHE" in caplog.text
