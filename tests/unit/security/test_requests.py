"""Certificates of keys that never leave their host."""

import stat

import pytest

from rpod.pki.command import accept_command, request_command, sign_command
from rpod_security.authority import Authority
from rpod_security.credentials import IDENTITY, KEY, REQUEST, Credentials


@pytest.fixture
def pki(tmp_path):
    return Authority.create(tmp_path / "pki").folder


def test_a_key_made_on_its_host_becomes_credentials_and_the_authority_never_has_it(tmp_path, pki):
    here = tmp_path / "host" / "estimator"
    assert request_command(here, "estimator") == 0
    assert stat.S_IMODE((here / KEY).stat().st_mode) == 0o600
    assert sign_command(pki, here / REQUEST, hosts=(), days=1.0) == 0
    assert b"PRIVATE" not in (pki / "estimator" / IDENTITY).read_bytes()
    assert accept_command(pki / "estimator", here) == 0
    assert Credentials.read(here).identity.common_name == "estimator.1"
    assert not (here / KEY).exists()
    assert request_command(here, "estimator") == 0, "a renewal"
    assert sign_command(pki, here / REQUEST, hosts=(), days=1.0) == 0
    assert accept_command(pki / "estimator", here) == 0
    assert [entry.generation for entry in Authority.open(pki).valid] == [1]


def test_a_request_of_an_unknown_role_or_a_name_in_use_or_changed_is_refused(tmp_path, pki, capsys):
    Authority.open(pki).issue("view", "estimator")
    assert request_command(tmp_path / "estimator", "king") == 2
    assert request_command(tmp_path / "estimator", "estimator") == 0
    assert request_command(tmp_path / "estimator", "estimator") == 1
    assert sign_command(pki, tmp_path / "estimator" / REQUEST, hosts=(), days=1.0) == 1
    assert "in use by a view" in capsys.readouterr().err
    broken = tmp_path / "broken.pem"
    broken.write_text("no request")
    assert sign_command(pki, broken, hosts=(), days=1.0) == 1


def test_a_certificate_of_another_key_is_not_accepted(tmp_path, pki, capsys):
    one, two = tmp_path / "a" / "view", tmp_path / "b" / "view"
    for folder in (one, two):
        assert request_command(folder, "view") == 0
    assert sign_command(pki, one / REQUEST, hosts=(), days=1.0) == 0
    assert accept_command(pki / "view", two) == 1
    assert "of another key" in capsys.readouterr().err
    assert not (two / IDENTITY).exists()
