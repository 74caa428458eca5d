"""Digest chains of logs: what was changed, cut, added or forged is found, by each way that there is."""

import json
from datetime import timedelta

import pytest

from rpod_security.authority import Authority
from rpod_security.errors import ChainError
from rpod_security.log_chain import ChainWriter, chain_of
from rpod_security.log_signature import SigningKey
from rpod_security.log_verification import verify

PARTS = b"first part", b"second part", b"end"


def write(log, key=None, before=None, closed=True):
    chain = ChainWriter(log, key=key, continues=before)
    with log.open("wb") as stream:
        for part in PARTS:
            stream.write(part)
            chain.add(part)
            chain.seal(closed=closed and part == PARTS[-1])
    chain.close()
    return log


@pytest.fixture(scope="module")
def pki(tmp_path_factory):
    authority = Authority.create(tmp_path_factory.mktemp("pki") / "pki")
    authority.issue("logger", "logger", validity=timedelta(days=1))
    authority.issue("view", "view", validity=timedelta(days=1))
    return authority.folder


def key(pki, name="logger"):
    return SigningKey.read(pki / name)


def authority(pki):
    return pki / "logger" / "authority.pem"


def test_a_log_as_it_was_written_is_intact_and_a_chain_without_signatures_says_so(tmp_path):
    result = verify(write(tmp_path / "run.mcap"))
    assert result.intact
    assert result.closed
    assert result.verified_bytes == sum(map(len, PARTS))
    assert result.notes == ["the chain has no signatures: it shows damage, but not forgery"]


def test_a_signed_log_names_the_logger_of_the_authority(tmp_path, pki):
    result = verify(write(tmp_path / "run.mcap", key(pki)), authority=authority(pki))
    assert (result.problems, result.notes, result.signed_by) == ([], [], "logger.1")


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda data: b"F" + data[1:], "bytes 0 to 10 are not those that were written"),
        (lambda data: data[:-1], "the log ends at byte 23, 24 were written"),
        (lambda data: data + b"x", "1 bytes were added after the log was closed"),
        (lambda _: b"", "the log ends at byte 0, 10 were written"),
    ],
)
def test_a_changed_log_is_not_intact(tmp_path, change, problem):
    log = write(tmp_path / "run.mcap")
    log.write_bytes(change(log.read_bytes()))
    assert problem in verify(log).problems[0]


def lines_of(log):
    return [json.loads(line) for line in chain_of(log).read_bytes().splitlines()]


def test_a_chain_that_was_made_anew_lacks_the_signatures_and_a_line_left_out_is_found(tmp_path, pki):
    log = write(tmp_path / "run.mcap", key(pki))
    lines = chain_of(log).read_bytes().splitlines(keepends=True)
    chain_of(log).write_bytes(b"".join(lines[:2] + lines[3:]))
    assert "line 3 of the chain does not follow the line before" in verify(log).problems
    chain_of(log).write_bytes(lines[0] + lines[1].replace(b'"size":10', b'"size":11') + b"".join(lines[2:]))
    assert "line 2 of the chain is not signed by logger" in verify(log).problems
    forged = write(tmp_path / "forged.mcap")
    assert verify(forged, authority=authority(pki)).problems == [
        "an authority was given, but nobody signed the chain"
    ]


def test_a_certificate_of_another_role_or_authority_signs_no_log(tmp_path, pki):
    by_viewer = write(tmp_path / "viewer.mcap", key(pki, "view"))
    assert "of a view, not of a logger" in verify(by_viewer, authority=authority(pki)).problems[0]
    other = Authority.create(tmp_path / "other")
    other.issue("logger", "logger")
    stranger = write(tmp_path / "stranger.mcap", SigningKey.read(tmp_path / "other" / "logger"))
    assert "is not of this authority" in verify(stranger, authority=authority(pki)).problems[0]


def test_a_log_that_was_not_closed_is_intact_up_to_the_last_sync(tmp_path):
    log = write(tmp_path / "run.mcap", closed=False)
    with log.open("ab") as stream:
        stream.write(b"open chunk")
    result = verify(log)
    assert result.intact
    assert not result.closed
    assert "the last 10 bytes came after the last sync, and are not covered" in result.notes


def test_the_chain_of_the_log_before_cannot_be_replaced(tmp_path):
    first = write(tmp_path / "run.mcap")
    second = write(tmp_path / "run_0002.mcap", before=first)
    assert verify(second).intact
    chain_of(first).unlink()
    assert "run.mcap, which it continues, is not beside it" in verify(second).notes
    write(first)
    assert "the chain of run.mcap, which it continues, was changed" in verify(second).problems[0]


@pytest.mark.parametrize("text", [b"", b"{}", b"[" * 100_000, b"\xff"])
def test_a_damaged_chain_is_one_error(tmp_path, text):
    log = write(tmp_path / "run.mcap")
    chain_of(log).write_bytes(text)
    with pytest.raises(ChainError, match=r"run\.mcap\.chain"):
        verify(log)
    chain_of(log).unlink()
    with pytest.raises(ChainError, match="digest_chain"):
        verify(log)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("continues", "../other/run.mcap"),
        ("continues", ""),
        ("continues", "a" * 300),
        ("certificate", "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n"),
        ("certificate", "\ud800"),
    ],
)
def test_a_first_line_with_hostile_values_is_one_error(tmp_path, field, value):
    log = write(tmp_path / "run.mcap")
    head, *rest = lines_of(log)
    text = "\n".join(json.dumps(each) for each in (head | {field: value}, *rest))
    chain_of(log).write_text(text + "\n")
    with pytest.raises(ChainError, match=r"run\.mcap\.chain"):
        verify(log)


def test_a_time_that_no_calendar_has_is_one_error(tmp_path):
    log = write(tmp_path / "run.mcap")
    log.write_bytes(b"F" + log.read_bytes()[1:])
    head, first, *rest = lines_of(log)
    late = first | {"time": "9999-12-31T23:59:59-23:00"}
    chain_of(log).write_text("\n".join(json.dumps(each) for each in (head, late, *rest)) + "\n")
    with pytest.raises(ChainError, match="is damaged"):
        verify(log)
