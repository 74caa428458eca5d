"""A folder of credentials: what a service needs to be known on a secure bus.

``authority.pem`` is the authority's certificate, ``identity.pem`` the service's certificate and private key
in one file, so that one rename replaces both. The folder is all that goes to the service's host.
"""

import stat
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Self

from cryptography import x509
from cryptography.hazmat.primitives import serialization

from rpod_schemas.caches.whole_file import whole_file
from rpod_security.certificates import Identity, public_pem, requested
from rpod_security.errors import CredentialsError

AUTHORITY, IDENTITY, AUDIT = "authority.pem", "identity.pem", "audit.jsonl"
KEY, REQUEST = "key.pem", "request.pem"
"""A key that waits for its certificate, and the request for it."""
WARN_BEFORE = timedelta(days=30)
"""Time before the end of a certificate from which it is told."""
_PRIVATE_FOLDER, _PRIVATE_FILE = 0o700, 0o600
_ISSUE = "make it with 'rpod pki issue'"


@dataclass(frozen=True)
class Credentials:
    """Certificate and key of one service or of the router."""

    folder: Path
    identity: Identity
    """Whom the certificate names."""
    ends: datetime
    """Last moment at which both the certificate and that of the authority are valid."""

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read and check a folder. Raises ``CredentialsError``."""
        folder = folder.absolute()
        try:
            certificate = x509.load_pem_x509_certificate((folder / IDENTITY).read_bytes())
            authority = x509.load_pem_x509_certificate((folder / AUTHORITY).read_bytes())
            identity = Identity.of(certificate)
            certificate.verify_directly_issued_by(authority)
        except OSError as error:
            reason = f"{Path(str(error.filename)).name} cannot be read ({error.strerror})"
            raise CredentialsError(folder, reason, _ISSUE) from error
        except Exception as error:
            reason = str(error) or "its certificate is not of its authority"
            raise CredentialsError(folder, f"is no folder of credentials: {reason}", _ISSUE) from error
        _check_private(folder / IDENTITY)
        return cls(folder, identity, min(certificate.not_valid_after_utc, authority.not_valid_after_utc))

    def joining(self, link: "Credentials") -> dict[str, Any]:
        """Return Zenoh's settings of a router that joins another one, by the certificate of its link."""
        return link.tls(listens=False) | self.tls(listens=True)

    @property
    def warning(self) -> str:
        """Warning that the certificate ends soon, or has ended; empty if neither."""
        left = self.ends - datetime.now(UTC)
        if left > WARN_BEFORE:
            return ""
        when = f"{self.ends:%Y-%m-%d %H:%M} UTC"
        state = f"expires in {left.days} days, at {when}" if left > timedelta(0) else f"expired at {when}"
        return f"the certificate of {self.identity.name} {state}; 'rpod pki renew {self.identity.name}'"

    def tls(self, *, listens: bool) -> dict[str, Any]:
        """Return Zenoh's settings ``transport/link/tls``: both sides show a certificate, and check it."""
        side = "listen" if listens else "connect"
        identity = str(self.folder / IDENTITY)
        return {
            "root_ca_certificate": str(self.folder / AUTHORITY),
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
            f"{side}_certificate": identity,
            f"{side}_private_key": identity,
        }


class ExpiryWatch:
    """Warns before a certificate ends; notices that it was replaced."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._changed_ns = -1
        self._credentials: Credentials | None = None

    def warning(self) -> str:
        """Return the warning of now, empty if there is none; never raises."""
        try:
            changed_ns = (self._folder / IDENTITY).stat().st_mtime_ns
            if self._credentials is None or changed_ns != self._changed_ns:
                self._credentials, self._changed_ns = Credentials.read(self._folder), changed_ns
        except OSError as error:
            return (
                f"the certificate cannot be used for the next connection: {self._folder} ({error.strerror})"
            )
        except CredentialsError as error:
            return f"the certificate cannot be used for the next connection: {error}"
        return self._credentials.warning


def write_credentials(folder: Path, *, authority: bytes, identity: bytes) -> None:
    """Write a folder that its owner alone can read; each file is replaced in one step. Raises ``OSError``."""
    make_private(folder)
    write_private(folder / AUTHORITY, authority)
    write_private(folder / IDENTITY, identity)


def write_request(folder: Path, role: str) -> Path:
    """Make a key in a folder, whose name is that of the service, and a request; return the request's file.

    Raises:
        CredentialsError: the folder has a key that waits for its certificate.
        OSError: it cannot be written.
    """
    make_private(folder)
    if (folder / KEY).exists():
        raise CredentialsError(
            folder, "has a key already that waits for its certificate", f"remove {folder / KEY}"
        )
    key, request = requested(folder.name, role)
    write_private(folder / KEY, key)
    write_private(folder / REQUEST, request)
    return folder / REQUEST


def accept_certificate(folder: Path, authority: bytes, certificate: bytes) -> None:
    """Add the certificate to a folder that holds its key; an old certificate stays until then.

    Raises:
        CredentialsError: the certificate is of another key, or not of this authority.
        OSError: a file cannot be read or written.
    """
    key = (folder / KEY).read_bytes()
    try:
        found = x509.load_pem_x509_certificate(certificate)
        private = serialization.load_pem_private_key(key, None)
        found.verify_directly_issued_by(x509.load_pem_x509_certificate(authority))
    except Exception as error:
        raise CredentialsError(
            folder, f"the certificate cannot be used: {error}", "sign the request again"
        ) from error
    if found.public_key() != private.public_key():
        raise CredentialsError(folder, "the certificate is of another key", "send the newest request")
    write_credentials(folder, authority=authority, identity=public_pem(found) + key)
    for name in (KEY, REQUEST):
        (folder / name).unlink(missing_ok=True)


def make_private(folder: Path) -> None:
    """Make a folder that its owner alone can read. Raises ``OSError``."""
    folder.mkdir(parents=True, exist_ok=True)
    folder.chmod(_PRIVATE_FOLDER)


def write_private(file: Path, content: bytes) -> None:
    """Replace a file in one step; at no time can others than its owner read it. Raises ``OSError``."""
    with whole_file(file, mode=_PRIVATE_FILE, durable=True) as stream:
        stream.write(content)


def _check_private(file: Path) -> None:
    mode = stat.S_IMODE(file.stat().st_mode)
    if mode & ~_PRIVATE_FILE:
        raise CredentialsError(
            file, f"has mode {mode:04o}, so that others may read the private key", f"chmod 600 {file}"
        )
