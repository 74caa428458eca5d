"""The configuration of the proxy, which stands between services and the router and makes links faulty."""

from pydantic import Field

from rpod_schemas.config.base import Config, Name
from rpod_schemas.config.service import ServiceConfig


class ProxiedLink(Config):
    """One link that passes through the proxy."""

    listen: str = Field(pattern=r"^[^\s:]+:\d{1,5}$")
    """Address and port on which the proxy listens, as ``127.0.0.1:7450``; the service connects to them. An
    encrypted link stays so: the proxy passes bytes on."""
    target: str = Field(pattern=r"^[^\s:]+:\d{1,5}$")
    """Address and port of the router."""


class ProxyConfig(ServiceConfig):
    """Configuration of the proxy. Its own link to the router, ``bus``, passes through no proxy."""

    instance: Name = "proxy"
    """Name on the bus."""
    links: dict[Name, ProxiedLink] = Field(min_length=1)
    """Links by the name of the service that uses each."""
    seed: int = Field(default=0, ge=0)
    """Seed of the lost packets."""
