"""What every service's configuration has: its name and the bus."""

from typing import Literal

from pydantic import Field

from rpod_schemas.config.base import Config, Name, Positive
from rpod_schemas.topics import Namespace

ESTIMATOR_ID = "e57a7e"
"""Zenoh identity of an estimator unless configured; the router keeps the truth from it."""


class BusConfig(Config):
    """How a service reaches the bus."""

    connect: str = Field(default="tcp/127.0.0.1:7447", pattern=r"^(tcp|tls|quic|unixsock-stream)/.+")
    """Zenoh endpoint of the router."""
    domain: int = Field(default=0, ge=0, le=232)
    """ROS domain."""
    namespace: str = Field(default="", pattern=r"^([A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*)?$")
    """ROS namespace without slashes at its ends: one target a namespace."""
    connect_timeout_s: Positive = 5.0
    """How long to try to reach the router before giving up."""
    wait: bool = False
    """Wait for the router as long as it takes."""

    @property
    def keys(self) -> Namespace:
        """Where in the key space the facility lives."""
        return Namespace(self.domain, self.namespace)


class ServiceConfig(Config):
    """What every service needs."""

    instance: Name
    """Name of this process on the bus and in its log lines."""
    bus: BusConfig = BusConfig()
    """The bus."""
    zenoh_id: str = Field(default="", pattern=r"^[0-9a-f]{0,32}$")
    """Identity under which the router's access rules know this client; random where empty."""
    time_source: Literal["wall", "clock"] = "wall"
    """Against what late and future are judged: this machine's clock, or the topic ``clock``."""


class RouterConfig(Config):
    """The bus itself, and who may not read what."""

    instance: Name = "router"
    """Name of this process in its log lines."""
    listen: str = Field(default="tcp/127.0.0.1:7447", pattern=r"^(tcp|tls|quic|unixsock-stream)/.+")
    """Zenoh endpoint to listen on."""
    estimators: tuple[str, ...] = (ESTIMATOR_ID,)
    """Zenoh identities that may not read the truth, of whatever domain and namespace."""
