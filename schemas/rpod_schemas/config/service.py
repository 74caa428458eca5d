"""Configuration that every service has: its name and the bus."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from rpod_schemas.config.base import BUS_NAMESPACE, ENDPOINT, LIVE, Config, Name, Positive
from rpod_schemas.config.facility.link import Link, LinkConfig
from rpod_schemas.topics import Namespace

ESTIMATOR_ID = "e57a7e"
"""Default Zenoh identity of an estimator, from which the router withholds the truth."""


LogLevel = Literal["debug", "info", "warning", "error"]
TimeSource = Literal["wall", "clock"]


def _check_tls(field: str, endpoint: str, credentials: Path | None) -> None:
    """Raise ``ValueError`` if an endpoint and the credentials do not fit each other."""
    encrypted = endpoint.startswith(("tls/", "quic/"))
    if credentials is not None and not encrypted:
        address = endpoint.split("/", 1)[-1]
        raise ValueError(f"{field} is {endpoint}, but credentials need an endpoint such as tls/{address}")
    if credentials is None and encrypted:
        raise ValueError(
            f"{field} is {endpoint}, which needs credentials: the folder that 'rpod pki issue' made"
        )


class BusConfig(Config):
    """Connection of a service to the bus."""

    connect: str = Field(default="tcp/127.0.0.1:7447", pattern=ENDPOINT)
    """Zenoh endpoint of the router."""
    domain: int = Field(default=0, ge=0, le=232)
    """ROS domain."""
    namespace: str = Field(default="", pattern=BUS_NAMESPACE)
    """ROS namespace without slashes at its ends; each target needs its own."""
    connect_timeout_s: Positive = 5.0
    """Longest time to try to reach the router, s."""
    wait: bool = False
    """Whether to wait for the router without limit."""
    credentials: Path | None = None
    """Folder of this service's certificate and key, made by ``rpod pki issue``. With it the connection is
    encrypted, and the router knows the service by its certificate."""
    link: Link = LinkConfig()
    """Tuning of the link to the router: ``slow`` for a link of some megabits a second, or one that breaks."""
    ros_services: bool = True
    """Whether services can be controlled, and their parameters read, by calls of ROS 2 services."""

    @model_validator(mode="after")
    def _certificates_need_tls(self) -> Self:
        _check_tls("connect", self.connect, self.credentials)
        return self

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
    log_level: Annotated[LogLevel, LIVE] = "info"
    """Least level of log lines. It changes without a restart: correct the file, then SIGHUP or ``reload``."""
    time_source: TimeSource = "wall"
    """Clock that decides which messages are late or in the future: that of this machine, or the topic
    ``clock``."""

    @property
    def in_lockstep(self) -> bool:
        """Whether time comes from the topic ``clock``, so that services wait for each other."""
        return self.time_source == "clock"


class RouterConfig(Config):
    """Configuration of the router, which withholds the truth from estimators."""

    instance: Name = "router"
    """Name of this process in its log lines."""
    log_level: Annotated[LogLevel, LIVE] = "info"
    """Least level of log lines. It changes without a restart: correct the file, then SIGHUP or ``reload``."""
    listen: str = Field(default="tcp/127.0.0.1:7447", pattern=ENDPOINT)
    """Zenoh endpoint to listen on."""
    connect: tuple[Annotated[str, Field(pattern=ENDPOINT)], ...] = ()
    """Zenoh endpoints of the routers of other hosts, to which this one connects and connects again. Each
    router checks its own clients; one of the two names the other."""
    estimators: tuple[str, ...] = (ESTIMATOR_ID,)
    """Zenoh identities that may not read the truth, in any domain and namespace."""
    credentials: Path | None = None
    """Folder of the router's certificate and key, made by ``rpod pki init``. With it every client needs a
    certificate of the same authority, and may do what ``rules`` allow it."""
    link_credentials: Path | None = None
    """Folder of the certificate, of the role ``link``, by which the routers in ``connect`` know this one; of
    the profile secure alone."""
    rules: Path | None = None
    """File of the access rules, made by ``rpod pki rules``."""
    handshake_timeout_s: float = Field(default=1.0, ge=0.01, le=10.0)
    """Longest TLS handshake, s; it takes two round trips on the network."""
    link: Link = LinkConfig()
    """Tuning of the links to all clients, as ``bus.link`` of a service."""
    max_clients: int = Field(default=1000, ge=1, le=5000)
    """Largest number of clients that are connected at a time."""

    @model_validator(mode="after")
    def _certificates_need_rules(self) -> Self:
        _check_tls("listen", self.listen, self.credentials)
        for endpoint in self.connect:
            _check_tls("connect", endpoint, self.credentials)
        joins = bool(self.connect) and self.credentials is not None
        if joins != (self.link_credentials is not None):
            raise ValueError(
                "connect: a router of the profile secure needs link_credentials, a certificate of the role "
                "link, to join others, and none without (rpod pki issue link NAME)"
            )
        if (self.credentials is None) != (self.rules is None):
            raise ValueError(
                "credentials and rules make the profile secure together: give both (rpod pki rules) or none"
            )
        return self
