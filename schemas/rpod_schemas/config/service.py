"""Configuration that every service has: its name and the bus."""

from typing import Annotated, Literal

from pydantic import Field

from rpod_schemas.config.base import Config, Name, Positive
from rpod_schemas.topics import Namespace

_ENDPOINT = r"^(tcp|tls|quic|unixsock-stream)/.+"
ESTIMATOR_ID = "e57a7e"
"""Default Zenoh identity of an estimator, from which the router withholds the truth."""


LogLevel = Literal["debug", "info", "warning", "error"]


class BusConfig(Config):
    """Connection of a service to the bus."""

    connect: str = Field(default="tcp/127.0.0.1:7447", pattern=_ENDPOINT)
    """Zenoh endpoint of the router."""
    domain: int = Field(default=0, ge=0, le=232)
    """ROS domain."""
    namespace: str = Field(default="", pattern=r"^([A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*)?$")
    """ROS namespace without slashes at its ends; each target needs its own."""
    connect_timeout_s: Positive = 5.0
    """Longest time to try to reach the router, s."""
    wait: bool = False
    """Whether to wait for the router without limit."""
    ros_services: bool = True
    """Whether services can be controlled, and their parameters read, by calls of ROS 2 services."""

    @property
    def keys(self) -> Namespace:
        """Part of the key space that the facility uses."""
        return Namespace(self.domain, self.namespace)


class ServiceConfig(Config):
    """Configuration that every service needs."""

    instance: Name
    """Name of this process on the bus and in its log lines."""
    bus: BusConfig = BusConfig()
    """Connection to the bus."""
    zenoh_id: str = Field(default="", pattern=r"^[0-9a-f]{0,32}$")
    """Zenoh identity by which the router's access rules know this client; random if empty."""
    log_level: LogLevel = "info"
    """Least level of log lines. It changes without a restart: correct the file, then SIGHUP."""
    time_source: Literal["wall", "clock"] = "wall"
    """Clock that decides which messages are late or in the future: that of this machine, or the topic
    ``clock``."""


class RouterConfig(Config):
    """Configuration of the router, which withholds the truth from estimators."""

    instance: Name = "router"
    """Name of this process in its log lines."""
    log_level: LogLevel = "info"
    """Least level of log lines. It changes without a restart: correct the file, then SIGHUP."""
    listen: str = Field(default="tcp/127.0.0.1:7447", pattern=_ENDPOINT)
    """Zenoh endpoint to listen on."""
    connect: tuple[Annotated[str, Field(pattern=_ENDPOINT)], ...] = ()
    """Zenoh endpoints of the routers of other hosts, to which this one connects and connects again. Each
    router judges its own clients; one of the two names the other."""
    estimators: tuple[str, ...] = (ESTIMATOR_ID,)
    """Zenoh identities that may not read the truth, in any domain and namespace."""
