"""Files that are replaced in one step."""

import stat

import pytest

from rpod_schemas.caches.whole_file import whole_file


@pytest.mark.parametrize("durable", [False, True])
def test_a_file_is_replaced_at_the_end_and_has_its_permissions_from_the_start(tmp_path, durable):
    file = tmp_path / "key.pem"
    file.write_bytes(b"old")
    with whole_file(file, mode=0o600, durable=durable) as stream:
        stream.write(b"new")
        (beside,) = tmp_path.glob("key.*.tmp")
        assert stat.S_IMODE(beside.stat().st_mode) == 0o600
        assert file.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [file]
    assert (file.read_bytes(), stat.S_IMODE(file.stat().st_mode)) == (b"new", 0o600)


def write_half(file):
    with whole_file(file) as stream:
        stream.write(b"ne")
        raise OSError("no room")


def test_after_an_error_the_old_file_is_there_and_no_other(tmp_path):
    file = tmp_path / "state"
    file.write_bytes(b"old")
    with pytest.raises(OSError, match="no room"):
        write_half(file)
    assert [(each, each.read_bytes()) for each in tmp_path.iterdir()] == [(file, b"old")]
