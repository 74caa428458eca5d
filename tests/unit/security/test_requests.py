"""Certificates of keys that never leave their host."""

import base64
import stat

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

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
    assert sign_command(pki, here / REQUEST, hosts=(), days=1.0, renews=True) == 0
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


def test_a_strangers_request_for_a_name_in_use_is_refused_and_the_role_that_it_asks_for_is_told(
    tmp_path, pki, capsys
):
    Authority.open(pki).issue("operator", "console")
    held = (pki / "console" / IDENTITY).read_bytes()
    assert request_command(tmp_path / "console", "operator") == 0
    assert sign_command(pki, tmp_path / "console" / REQUEST, hosts=(), days=1.0) == 1
    assert "repeat with --renew" in capsys.readouterr().err
    assert (pki / "console" / IDENTITY).read_bytes() == held
    assert request_command(tmp_path / "camera", "operator") == 0
    assert sign_command(pki, tmp_path / "camera" / REQUEST, hosts=(), days=1.0) == 0
    assert "certificate of camera, role operator: starts, resets and ends services" in capsys.readouterr().out


def test_a_request_with_an_unknown_signature_is_refused_in_one_line(tmp_path, pki, capsys):
    assert request_command(tmp_path / "view", "view") == 0
    request = x509.load_pem_x509_csr((tmp_path / "view" / REQUEST).read_bytes())
    ecdsa_sha256, unknown = bytes.fromhex("06082a8648ce3d040302"), bytes.fromhex("06082a8648ce3d040309")
    changed = request.public_bytes(Encoding.DER).replace(ecdsa_sha256, unknown)
    text = base64.encodebytes(changed).decode()
    begin, end = "-----BEGIN CERTIFICATE REQUEST-----\n", "-----END CERTIFICATE REQUEST-----\n"
    (tmp_path / "changed.pem").write_text(begin + text + end)
    assert sign_command(pki, tmp_path / "changed.pem", hosts=(), days=1.0) == 1
    assert "the request cannot be used" in capsys.readouterr().err
