"""Certificates (X.509, ECDSA on P-256) of the authority, of the router and of the services.

The common name is ``<name>.<generation>``. Access rules name it, so a name that was revoked can be issued
again: the new certificate has the next generation, and the rules no longer name the old one. The
organisational unit is the role.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from typing import Self

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

CLOCK_SLACK = timedelta(minutes=5)
"""Time before its issue from which a certificate is valid, for hosts whose clocks are behind."""
_USAGES = (
    "digital_signature", "content_commitment", "key_encipherment", "data_encipherment", "key_agreement",
    "key_cert_sign", "crl_sign", "encipher_only", "decipher_only",
)  # fmt: skip


@dataclass(frozen=True)
class Identity:
    """Name, generation and role in a certificate."""

    name: str
    """Name on the bus."""
    role: str
    """Role, by which the access rules are made."""
    generation: int = 1
    """Generation of the name: one more after each revocation."""

    @property
    def common_name(self) -> str:
        """Common name of the certificate, as access rules have it."""
        return f"{self.name}.{self.generation}"

    @classmethod
    def of(cls, certificate: x509.Certificate) -> Self:
        """Return the identity in a certificate. Raises ``ValueError``."""
        common, unit = (_part(certificate, oid) for oid in (NameOID.COMMON_NAME, _UNIT))
        name, _, generation = common.rpartition(".")
        if not name or not unit or not generation.isdigit():
            raise ValueError(f"its common name {common!r} and unit {unit!r} are not those of a role")
        return cls(name, unit, int(generation))


_UNIT = NameOID.ORGANIZATIONAL_UNIT_NAME


@dataclass(frozen=True)
class Signer:
    """Key and certificate of an authority."""

    key: ec.EllipticCurvePrivateKey
    certificate: x509.Certificate

    @classmethod
    def new(cls, *, validity: timedelta) -> Self:
        """Return a new authority, which signs itself."""
        key = ec.generate_private_key(ec.SECP256R1())
        name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "rpod authority")])
        certificate = (
            _builder(name, name, key.public_key(), validity)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage("key_cert_sign", "crl_sign"), critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
            .sign(key, hashes.SHA256())
        )
        return cls(key, certificate)

    def issue(
        self, identity: Identity, *, validity: timedelta, hosts: Sequence[str] = ()
    ) -> tuple[bytes, x509.Certificate]:
        """Return a new private key (PEM) and its certificate; ``hosts`` make it a router's."""
        key = ec.generate_private_key(ec.SECP256R1())
        return private_pem(key), self.certify(identity, key.public_key(), validity=validity, hosts=hosts)

    def certify(
        self,
        identity: Identity,
        key: ec.EllipticCurvePublicKey,
        *,
        validity: timedelta,
        hosts: Sequence[str] = (),
    ) -> x509.Certificate:
        """Return a certificate of somebody's public key, not valid for longer than that of the authority."""
        subject = _subject(identity.common_name, identity.role)
        left = self.certificate.not_valid_after_utc - datetime.now(UTC)
        purpose = ExtendedKeyUsageOID.SERVER_AUTH if hosts else ExtendedKeyUsageOID.CLIENT_AUTH
        builder = (
            _builder(subject, self.certificate.subject, key, min(validity, left))
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage("digital_signature"), critical=True)
            .add_extension(x509.ExtendedKeyUsage([purpose]), critical=False)
            .add_extension(
                x509.AuthorityKeyIdentifier.from_issuer_public_key(self.key.public_key()), critical=False
            )
        )
        if hosts:
            names = x509.SubjectAlternativeName([_host(host) for host in hosts])
            builder = builder.add_extension(names, critical=False)
        return builder.sign(self.key, hashes.SHA256())


def requested(name: str, role: str) -> tuple[bytes, bytes]:
    """Return a new private key and a request for its certificate (PKCS 10), both PEM."""
    key = ec.generate_private_key(ec.SECP256R1())
    request = x509.CertificateSigningRequestBuilder().subject_name(_subject(name, role))
    return private_pem(key), request.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)


def read_request(pem: bytes) -> tuple[str, str, ec.EllipticCurvePublicKey]:
    """Return name, role and public key of a request. Raises ``ValueError``."""
    request = x509.load_pem_x509_csr(pem)
    key = request.public_key()
    if not request.is_signature_valid:
        raise ValueError("it is not signed by its own key")
    if not isinstance(key, ec.EllipticCurvePublicKey) or key.curve.name != ec.SECP256R1.name:
        raise ValueError("its key is not of the curve P-256")
    return _part(request, NameOID.COMMON_NAME), _part(request, _UNIT), key


def _subject(name: str, role: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name), x509.NameAttribute(_UNIT, role)])


def private_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    """Return a private key as PEM, without a passphrase."""
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def public_pem(certificate: x509.Certificate) -> bytes:
    """Return a certificate as PEM."""
    return certificate.public_bytes(serialization.Encoding.PEM)


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, validity: timedelta
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(min(now, now + validity) - CLOCK_SLACK)
        .not_valid_after(now + validity)
    )


def _usage(*allowed: str) -> x509.KeyUsage:
    return x509.KeyUsage(**{name: name in allowed for name in _USAGES})


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _part(certificate: x509.Certificate | x509.CertificateSigningRequest, oid: x509.ObjectIdentifier) -> str:
    found = certificate.subject.get_attributes_for_oid(oid)
    return str(found[0].value) if len(found) == 1 else ""
