"""Signatures of the digest chains of logs, by the key of the logger's certificate (extra ``secure``)."""

import base64
from datetime import datetime
from pathlib import Path
from typing import Self

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

from rpod_security.certificates import Identity, public_pem
from rpod_security.credentials import IDENTITY
from rpod_security.errors import ChainError

LOGGER = "logger"
"""Role whose certificates sign logs."""


class SigningKey:
    """Key and certificate of a logger."""

    def __init__(self, key: ec.EllipticCurvePrivateKey, certificate: x509.Certificate) -> None:
        self._key = key
        self.certificate_pem = public_pem(certificate).decode()

    @classmethod
    def read(cls, credentials: Path) -> Self:
        """Read the key of a folder of credentials. Raises ``ChainError``."""
        file = credentials / IDENTITY
        try:
            pem = file.read_bytes()
            key = serialization.load_pem_private_key(pem, None)
            certificate = x509.load_pem_x509_certificate(pem)
        except (OSError, ValueError, TypeError, UnsupportedAlgorithm) as error:  # TypeError: a passphrase
            raise ChainError(file, f"cannot sign a log ({error})") from error
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise ChainError(file, "cannot sign a log: is no key of an elliptic curve")
        return cls(key, certificate)

    def sign(self, text: bytes) -> str:
        """Return a signature (ECDSA with SHA-256), base64."""
        return base64.b64encode(self._key.sign(text, ec.ECDSA(hashes.SHA256()))).decode()


class Signatory:
    """The certificate that a chain names, by which its lines are checked."""

    def __init__(self, file: Path, certificate_pem: str) -> None:
        """Read the certificate. Raises ``ChainError``."""
        try:
            self._certificate = x509.load_pem_x509_certificate(certificate_pem.encode())
            self.identity = Identity.of(self._certificate)
            self._key = self._certificate.public_key()
        except (ValueError, UnsupportedAlgorithm) as error:
            raise ChainError(file, f"names no certificate of a role ({error})") from error

    def signed(self, text: bytes, signature: str) -> bool:
        """Return whether a signature is of this certificate's key."""
        if not isinstance(self._key, ec.EllipticCurvePublicKey):
            return False
        try:
            self._key.verify(base64.b64decode(signature, validate=True), text, ec.ECDSA(hashes.SHA256()))
        except (InvalidSignature, ValueError):
            return False
        return True

    def rejection(self, authority: Path, *, when: datetime) -> str:
        """Return why the certificate was not that of a logger of an authority at a time; empty if it was.

        Args:
            authority: the authority's certificate, ``authority.pem`` of any folder of credentials.
            when: time of the signature.

        Raises:
            ChainError: the authority's certificate cannot be read.
        """
        try:
            issuer = x509.load_pem_x509_certificate(authority.read_bytes())
        except (OSError, ValueError) as error:
            raise ChainError(
                authority,
                f"is no certificate of an authority ({error}); give authority.pem of any credentials",
            ) from error
        try:
            self._certificate.verify_directly_issued_by(issuer)
        except (ValueError, TypeError, InvalidSignature, UnsupportedAlgorithm):
            return f"the certificate of {self.identity.name} is not of this authority"
        if self.identity.role != LOGGER:
            return f"the certificate is of a {self.identity.role}, not of a {LOGGER}"
        if not self._certificate.not_valid_before_utc <= when <= self._certificate.not_valid_after_utc:
            return f"the certificate of {self.identity.name} was not valid at {when:%Y-%m-%d %H:%M} UTC"
        return ""
