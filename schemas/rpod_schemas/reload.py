"""The reply of a service that read its configuration again (ICD section 4).

It stands apart from the other replies, which need sensors and poses: a router needs this one only, and is
started again in a third of the time.
"""

from typing import Any

from pydantic import Field

from rpod_schemas.config.base import Config


class ReloadReply(Config):
    """Changes of a service that read its configuration again."""

    changed: dict[str, Any] = Field(default_factory=dict)
    """New values of the fields that have changed, by name."""
    needs_restart: tuple[str, ...] = ()
    """Fields, joined by dots, in which the file differs and that do not change while the service runs."""
