"""The authority of a facility: issues, renews and revokes certificates, and keeps a ledger of them.

Its folder (``pki/authority``) belongs on a host, or a stick, of its own and never on the router's. Beside it
stands one folder of credentials for each name, to be copied to the host of its service.
"""

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Self

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec
from pydantic import AwareDatetime, TypeAdapter, ValidationError

from rpod_schemas.config.base import Config, Name
from rpod_security.certificates import Identity, Signer, private_pem, public_pem, read_request
from rpod_security.credentials import AUTHORITY, IDENTITY, make_private, write_credentials, write_private
from rpod_security.errors import AuthorityError
from rpod_security.roles import ROLES, ROUTER

FOLDER = "authority"
"""Name of the authority's folder, which no service may have."""
AUTHORITY_DAYS, ROLE_DAYS = 3650, 365
"""Default validity of the authority's certificate and of all others."""
_KEY, _LEDGER = "key.pem", "ledger.json"
_LONGEST_NAME = 56
"""A common name has at most 64 characters (RFC 5280)."""


class Entry(Config):
    """Entry of the ledger for one name."""

    name: Name
    """Name on the bus; it is unique."""
    role: str
    """Role by which the access rules are made."""
    generation: int = 1
    """Generation of the name: one more after each revocation."""
    serial: str
    """Serial number of the newest certificate, hexadecimal digits."""
    ends: AwareDatetime
    """End of its validity."""
    hosts: tuple[str, ...] = ()
    """Names and addresses of a router's host."""
    revoked: AwareDatetime | None = None
    """Time at which the name was revoked; None if it was not."""

    @property
    def identity(self) -> Identity:
        """Identity in the certificate."""
        return Identity(self.name, self.role, self.generation)


_ENTRIES = TypeAdapter(list[Entry])


class Authority:
    """An authority in the folder of a facility's certificates."""

    def __init__(self, folder: Path, signer: Signer, entries: Sequence[Entry] = ()) -> None:
        self.folder = folder
        self._signer = signer
        self._entries = {entry.name: entry for entry in entries}

    @classmethod
    def create(cls, folder: Path, *, validity: timedelta = timedelta(days=AUTHORITY_DAYS)) -> Self:
        """Make a new authority.

        Raises:
            AuthorityError: there is one already.
        """
        own = folder / FOLDER
        if (own / _KEY).exists():
            raise AuthorityError(
                f"{own} holds an authority already; choose another folder, or 'rpod pki show'"
            )
        authority = cls(folder, Signer.new(validity=validity))
        make_private(own)
        write_private(own / AUTHORITY, public_pem(authority._signer.certificate))
        write_private(own / _LEDGER, b"[]")
        write_private(own / _KEY, private_pem(authority._signer.key))
        return authority

    @classmethod
    def open(cls, folder: Path) -> Self:
        """Read an authority. Raises ``AuthorityError``."""
        own = folder / FOLDER
        try:
            key = serialization.load_pem_private_key((own / _KEY).read_bytes(), None)
            certificate = x509.load_pem_x509_certificate((own / AUTHORITY).read_bytes())
            entries = _ENTRIES.validate_json((own / _LEDGER).read_bytes())
        except OSError as error:
            raise AuthorityError(
                f"{own} holds no authority ({error.strerror}); make one with 'rpod pki init'; or name the "
                "folder of an existing one with --pki"
            ) from error
        except (ValueError, TypeError, UnsupportedAlgorithm) as error:  # TypeError: the key has a passphrase
            raise AuthorityError(f"{own} cannot be read: {str(error).splitlines()[0]}") from error
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise AuthorityError(f"{own / _KEY}: is no key of an elliptic curve")
        return cls(folder, Signer(key, certificate), entries)

    @property
    def entries(self) -> tuple[Entry, ...]:
        """All names that were ever issued, in their order."""
        return tuple(self._entries[name] for name in sorted(self._entries))

    @property
    def valid(self) -> tuple[Entry, ...]:
        """The names that are not revoked."""
        return tuple(entry for entry in self.entries if entry.revoked is None)

    @property
    def ends(self) -> datetime:
        """End of the authority's own certificate."""
        return self._signer.certificate.not_valid_after_utc

    def issue(
        self,
        role: str,
        name: str,
        *,
        validity: timedelta = timedelta(days=ROLE_DAYS),
        hosts: Sequence[str] = (),
    ) -> Path:
        """Issue the first certificate of a name, or the first after its revocation; return its folder.

        Raises:
            AuthorityError: the role is unknown, or the name is empty, not allowed, or in use.
        """
        return self._sign(self._new(role, name, hosts), validity, tuple(hosts))

    def certify(
        self,
        request: bytes,
        *,
        validity: timedelta = timedelta(days=ROLE_DAYS),
        hosts: Sequence[str] = (),
        renews: bool = False,
    ) -> Path:
        """Issue a certificate for a key that never leaves its host; return the folder to be sent there.

        A request shows only that its sender has the new key, not who the sender is. So it gets a name that is
        in use, with the same role, only where it ``renews`` by the word of the operator.

        Raises:
            AuthorityError: the request cannot be used, or its role or name, as for ``issue``.
        """
        try:
            name, role, key = read_request(request)
        except (ValueError, UnsupportedAlgorithm) as error:
            raise AuthorityError(f"the request cannot be used: {error}") from error
        before = self._entries.get(name)
        if before and before.revoked is None and before.role == role:
            if not renews:
                raise AuthorityError(
                    f"name {name!r} is in use by a {role}: whoever sent this request would be taken for it; "
                    "if the request is a renewal from its host, repeat with --renew"
                )
            identity, hosts = before.identity, before.hosts
        else:
            identity = self._new(role, name, hosts)
        certificate = self._signer.certify(identity, key, validity=validity, hosts=hosts)
        return self._hand_out(identity, certificate, b"", tuple(hosts))

    def _new(self, role: str, name: str, hosts: Sequence[str]) -> Identity:
        """Return the identity of a name that has no valid certificate yet. Raises ``AuthorityError``."""
        if role not in ROLES:
            raise AuthorityError(f"role {role!r} is unknown; choose one of {', '.join(sorted(ROLES))}")
        if name == FOLDER or not _is_name(name):
            raise AuthorityError(
                f"name {name!r} is not allowed; take letters, digits, - and _, with a letter first, and "
                f"not {FOLDER!r}"
            )
        if (role == ROUTER) != bool(hosts):
            raise AuthorityError("hosts belong to a router's certificate, and to no other")
        before = self._entries.get(name)
        if before and before.revoked is None:
            raise AuthorityError(
                f"name {name!r} is in use by a {before.role}; 'rpod pki renew {name}' replaces its "
                f"certificate, 'rpod pki revoke {name}' takes its rights away"
            )
        generation = before.generation + 1 if before else 1
        return Identity(name, role, generation)

    def renew(self, name: str, *, validity: timedelta = timedelta(days=ROLE_DAYS)) -> Path:
        """Replace key and certificate of a name in its folder; the one before stays valid until its end.

        Raises:
            AuthorityError: the name was not issued, or was revoked.
        """
        entry = self._valid(name)
        return self._sign(entry.identity, validity, entry.hosts)

    def revoke(self, name: str) -> None:
        """Take a name's rights away from the next rules on, and delete its folder's key.

        Raises:
            AuthorityError: the name was not issued, or was revoked already.
        """
        entry = self._valid(name)
        self._keep(entry.model_copy(update={"revoked": datetime.now(UTC)}))
        (self.folder / name / IDENTITY).unlink(missing_ok=True)

    def _valid(self, name: str) -> Entry:
        entry = self._entries.get(name)
        if entry is None:
            raise AuthorityError(f"name {name!r} was never issued; 'rpod pki show' lists the names")
        if entry.revoked:
            raise AuthorityError(
                f"name {name!r} was revoked on {entry.revoked:%Y-%m-%d}; "
                f"'rpod pki issue {entry.role} {name}' issues it again"
            )
        return entry

    def _sign(self, identity: Identity, validity: timedelta, hosts: tuple[str, ...]) -> Path:
        key, certificate = self._signer.issue(identity, validity=validity, hosts=hosts)
        return self._hand_out(identity, certificate, key, hosts)

    def _hand_out(
        self, identity: Identity, certificate: x509.Certificate, key: bytes, hosts: tuple[str, ...]
    ) -> Path:
        """Note a certificate in the ledger and write the folder; without a key, its owner adds one."""
        folder = self.folder / identity.name
        self._keep(
            Entry(
                name=identity.name,
                role=identity.role,
                generation=identity.generation,
                serial=f"{certificate.serial_number:x}",
                ends=certificate.not_valid_after_utc,
                hosts=hosts,
            )
        )
        write_credentials(
            folder, authority=public_pem(self._signer.certificate), identity=public_pem(certificate) + key
        )
        return folder

    def _keep(self, entry: Entry) -> None:
        self._entries[entry.name] = entry
        write_private(self.folder / FOLDER / _LEDGER, _ENTRIES.dump_json(list(self.entries), indent=2))


def _is_name(name: str) -> bool:
    try:
        return len(TypeAdapter(Name).validate_python(name)) <= _LONGEST_NAME
    except ValidationError:
        return False
