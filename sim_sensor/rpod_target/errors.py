"""The error that this package raises."""

from rpod_schemas.errors import ConfigurationError


class TargetError(ConfigurationError):
    """Raised for a target that cannot be used; names the file, the field and the reason in one line."""
