"""The errors of certificates, rights and audit records."""

from pathlib import Path

from rpod_schemas.errors import RpodError


class SecurityError(RpodError):
    """Root of the errors that this package raises."""


class CredentialsError(SecurityError):
    """Certificate or key in a folder cannot be used; names the folder, the reason and the remedy."""

    def __init__(self, folder: Path | str, reason: str, remedy: str) -> None:
        super().__init__(f"{folder}: {reason}; {remedy}")


class AuthorityError(SecurityError):
    """The authority cannot do what was asked of it."""


class RulesError(SecurityError):
    """No access rules can be made of, or read from, a file."""

    def __init__(self, source: Path | str, reason: str) -> None:
        super().__init__(f"{source}: {reason}")


class AuditError(SecurityError):
    """An audit record cannot be written or is not as it was written."""


class ChainError(SecurityError):
    """A log cannot be signed, or its digest chain cannot be read."""

    def __init__(self, file: Path | str, reason: str) -> None:
        super().__init__(f"{file}: {reason}")
