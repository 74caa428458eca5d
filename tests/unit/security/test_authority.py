import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography.hazmat.primitives import serialization

from rpod_security.authority import Authority
from rpod_security.certificates import Identity
from rpod_security.credentials import AUTHORITY, IDENTITY, Credentials, ExpiryWatch
from rpod_security.errors import AuthorityError, CredentialsError


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return Authority.create(tmp_path)


def mode(file: Path) -> int:
    return stat.S_IMODE(file.stat().st_mode)


def test_keys_can_be_read_by_their_owner_alone(authority: Authority):
    folder = authority.issue("motion", "motion")
    assert mode(folder) == mode(authority.folder / "authority") == 0o700
    assert {mode(file) for each in (folder, authority.folder / "authority") for file in each.iterdir()} == {
        0o600
    }


def test_the_authoritys_key_is_in_no_folder_of_credentials(authority: Authority):
    key = (authority.folder / "authority" / "key.pem").read_text().split()[3]
    folder = authority.issue("router", "router", hosts=["localhost"])
    assert all(key not in file.read_text() for file in folder.iterdir())


def test_credentials_name_whom_they_were_issued_to(authority: Authority):
    credentials = Credentials.read(authority.issue("driver", "front-camera"))
    assert credentials.identity == Identity("front-camera", "driver", 1)
    assert not credentials.warning


@pytest.mark.parametrize("name", ["", " ", "a.b", "../x", "*", "a/b", "é", "authority", "1a", "x" * 57])
def test_a_name_that_could_be_mistaken_is_refused(authority: Authority, name: str):
    with pytest.raises(AuthorityError, match="is not allowed"):
        authority.issue("motion", name)


def test_a_name_is_unique_whatever_the_role(authority: Authority):
    authority.issue("motion", "one")
    with pytest.raises(AuthorityError, match="in use by a motion"):
        authority.issue("view", "one")


def test_an_unknown_role_is_refused_with_the_known_ones(authority: Authority):
    with pytest.raises(AuthorityError, match="estimator"):
        authority.issue("admin", "one")


def test_hosts_belong_to_routers_alone(authority: Authority):
    with pytest.raises(AuthorityError, match="router"):
        authority.issue("view", "one", hosts=["here"])
    with pytest.raises(AuthorityError, match="router"):
        authority.issue("router", "one")


def test_there_is_one_authority_in_a_folder(authority: Authority):
    with pytest.raises(AuthorityError, match="holds an authority already"):
        Authority.create(authority.folder)


def test_the_ledger_survives(authority: Authority):
    authority.issue("view", "one")
    authority.revoke("one")
    again = Authority.open(authority.folder)
    assert [entry.name for entry in again.entries] == ["one"]
    assert not again.valid


def test_a_key_with_a_passphrase_is_refused_in_one_line(authority: Authority):
    file = authority.folder / "authority" / "key.pem"
    key = serialization.load_pem_private_key(file.read_bytes(), None)
    secret = serialization.BestAvailableEncryption(b"secret")
    pem = key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, secret)
    file.write_bytes(pem)
    with pytest.raises(AuthorityError, match="cannot be read: Password was not given"):
        Authority.open(authority.folder)


def test_a_revoked_name_is_issued_again_with_the_next_generation(authority: Authority):
    folder = authority.issue("view", "one")
    authority.revoke("one")
    assert not (folder / IDENTITY).exists()
    with pytest.raises(AuthorityError, match="was revoked"):
        authority.renew("one")
    authority.issue("view", "one")
    assert Credentials.read(folder).identity.common_name == "one.2"


def test_a_renewed_certificate_has_another_key_and_the_same_name(authority: Authority):
    folder = authority.issue("view", "one", validity=timedelta(days=10))
    before, first = Credentials.read(folder), (folder / IDENTITY).read_bytes()
    authority.renew("one")
    after = Credentials.read(folder)
    assert after.identity == before.identity
    assert after.ends > before.ends
    assert first.split(b"PRIVATE KEY")[1] != (folder / IDENTITY).read_bytes().split(b"PRIVATE KEY")[1]


def test_no_certificate_outlives_its_authority(tmp_path: Path):
    authority = Authority.create(tmp_path, validity=timedelta(days=3))
    assert Credentials.read(authority.issue("view", "one")).ends <= authority.ends


def test_an_end_is_told_thirty_days_ahead_until_it_is_renewed(authority: Authority):
    folder = authority.issue("view", "one", validity=timedelta(days=31))
    watch = ExpiryWatch(folder)
    assert not watch.warning()
    authority.renew("one", validity=timedelta(days=29, hours=1))
    assert "expires in 29 days" in watch.warning()
    authority.renew("one", validity=timedelta(seconds=-1))
    assert "expired at" in watch.warning()
    authority.renew("one")
    assert not watch.warning()
    (folder / IDENTITY).unlink()
    assert "cannot be used" in watch.warning()


def test_a_key_that_others_can_read_is_refused_with_the_remedy(authority: Authority):
    folder = authority.issue("view", "one")
    (folder / IDENTITY).chmod(0o640)
    with pytest.raises(CredentialsError, match="chmod 600"):
        Credentials.read(folder)


@pytest.mark.parametrize(
    "content", [b"", b"text", b"-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n"]
)
def test_damaged_credentials_are_one_line(authority: Authority, content: bytes):
    folder = authority.issue("view", "one")
    (folder / IDENTITY).write_bytes(content)
    with pytest.raises(CredentialsError, match="rpod pki issue"):
        Credentials.read(folder)


def test_credentials_with_another_authority_beside_them_are_refused(authority: Authority, tmp_path: Path):
    folder = authority.issue("view", "one")
    other = Authority.create(tmp_path / "other").issue("view", "one")
    (folder / AUTHORITY).write_bytes((other / AUTHORITY).read_bytes())
    with pytest.raises(CredentialsError, match="not of its authority"):
        Credentials.read(folder)


def test_entries_tell_when_they_end(authority: Authority):
    authority.issue("view", "one", validity=timedelta(days=7))
    (entry,) = authority.valid
    assert timedelta(days=6) < entry.ends - datetime.now(UTC) <= timedelta(days=7)
