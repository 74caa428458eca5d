"""The error that this package raises."""

from rpod_schemas.errors import ConfigurationError


class TargetError(ConfigurationError):
    """The target cannot be used; the error names the file, the field and the reason in one line."""
