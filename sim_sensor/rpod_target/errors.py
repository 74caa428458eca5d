"""The error of this package."""

from rpod_schemas.errors import ConfigurationError


class TargetError(ConfigurationError):
    """A target that cannot be used: names the file, the field and the reason, in one line."""
