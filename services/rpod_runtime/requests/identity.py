"""Identity of a service on the bus, and of its clients; in the profile ``secure`` certificates state both."""

import time
from typing import TYPE_CHECKING, Protocol

from rpod_runtime.errors import NotThisServiceError, RefusedError
from rpod_schemas.config.service import ServiceConfig
from rpod_security.audit import AuditRecord

if TYPE_CHECKING:
    from rpod_security.credentials import ExpiryWatch

_RATES_HZ = {"status": 1000.0}
"""Largest rate at which one client is answered, Hz, by verb; lockstep queries ``status`` very often."""
_RATE_HZ = 20.0
"""The same for all other verbs: commands, which people and supervisors give."""
_BURST_S = 2.0
"""Time for which a client may save requests that it did not make, for a burst."""
LONGEST_REQUEST = 1 << 16
"""Largest request, bytes; a reset with a covariance has 2,000. The last one that was accepted of each verb
stands in every diagnostics message."""


def check_size(size: int) -> None:
    """Raise ``RefusedError`` if a request of so many bytes is too long to be read."""
    if size > LONGEST_REQUEST:
        raise RefusedError(f"the request has {size} bytes, at most {LONGEST_REQUEST} are read")


class Identity(Protocol):
    """Names at the ends of the control plane's keys, and the record of requests."""

    name: str
    """Name of this service's certificate; empty in the profile ``plain``."""

    @property
    def served(self) -> str:
        """Last part of the keys that the service serves."""
        ...

    def asker(self, key: str, verb: str) -> str:
        """Return the client that asks by a key. Raises ``RefusedError``: no name in the key, or a flood."""
        ...

    def record(self, *, asker: str, verb: str, request: str, outcome: str) -> None:
        """Record a request other than ``status``, with its outcome."""
        ...

    def warning(self) -> str:
        """Return a warning about the service's certificate; empty if there is none."""
        ...


def open_identity(config: ServiceConfig) -> Identity:
    """Return the identity that a configuration gives.

    Raises:
        CredentialsError: the folder of credentials cannot be used.
        NotThisServiceError: they are of another name.
        AuditError: the audit record cannot be read.
    """
    folder = config.bus.credentials
    if folder is None:
        return Anonymous()
    from rpod_security.credentials import AUDIT, Credentials, ExpiryWatch  # noqa: PLC0415 - of an extra

    credentials = Credentials.read(folder)
    name = credentials.identity.name
    if name != config.instance:
        raise NotThisServiceError(config.instance, name, folder)
    return Certified(name, AuditRecord(credentials.folder / AUDIT, name), ExpiryWatch(credentials.folder))


class Anonymous:
    """An identity without a name, for the profile ``plain``."""

    name = ""
    served = ""

    def asker(self, key: str, verb: str) -> str:  # noqa: ARG002 - of the protocol
        """Return an empty name."""
        return ""

    def record(self, *, asker: str, verb: str, request: str, outcome: str) -> None:
        """Record nothing: the commands are in the diagnostics."""

    def warning(self) -> str:
        """Return nothing."""
        return ""


class Certified:
    """Identity of a service with a certificate, for the profile ``secure``."""

    served = "*"

    def __init__(self, name: str, audit: AuditRecord, expiry: "ExpiryWatch") -> None:
        self.name = name
        self._audit, self._expiry = audit, expiry
        self._buckets: dict[tuple[str, str], _Bucket] = {}

    def asker(self, key: str, verb: str) -> str:
        """Return the name at the end of a key, which the router has compared with the certificate."""
        *_, by, name = key.split("/")
        if by != "by" or not name or "*" in name:
            raise RefusedError(f"{key} does not say who asks; ask .../{verb}/by/<your name>")
        kind = verb if verb in _RATES_HZ else ""
        bucket = self._buckets.setdefault((name, kind), _Bucket(_RATES_HZ.get(kind, _RATE_HZ)))
        if not bucket.take():
            raise RefusedError(f"{name} asks more than {bucket.rate_hz:g} times a second; ask less often")
        return name

    def record(self, *, asker: str, verb: str, request: str, outcome: str) -> None:
        """Append to the audit record. Raises ``AuditError``."""
        self._audit.add(role=asker, verb=verb, request=request, outcome=outcome)

    def warning(self) -> str:
        """Return the warning that the certificate ends soon."""
        return self._expiry.warning()


class _Bucket:
    """A bucket of tokens: lets a rate through, and short bursts."""

    def __init__(self, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self._tokens = rate_hz * _BURST_S
        self._last_s = time.monotonic()

    def take(self) -> bool:
        """Return whether one more may pass now."""
        now_s = time.monotonic()
        self._tokens = min(self.rate_hz * _BURST_S, self._tokens + (now_s - self._last_s) * self.rate_hz)
        self._last_s = now_s
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True
