"""Names that the options of a campaign take."""

from collections.abc import Collection

from rpod_schemas.errors import ConfigurationError


def require(option: str, name: str, known: Collection[str]) -> None:
    """Raise ConfigurationError if the value of an option is none of the known names."""
    if name not in known:
        raise ConfigurationError(option, "", f"needs {', '.join(known)}, not {name!r}")
