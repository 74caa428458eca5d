"""Configuration of who is on a secure bus, from which the router's access rules are made."""

from pathlib import Path
from typing import Self

from pydantic import Field, model_validator

from rpod_schemas.config.base import BUS_NAMESPACE, Config, Name
from rpod_schemas.config.source import SourceConfig
from rpod_schemas.topics import Namespace


class SensorGrant(Config):
    """A sensor that a member publishes."""

    kind: str
    """Kind of the sensor: ``pmd``, ``lidar``, or one that another installed package brings."""
    name: Name
    """Name of the sensor: the first part of its topics."""
    source: SourceConfig = SourceConfig()
    """Topics of a driver that does not keep to the ICD."""


class MemberConfig(Config):
    """Somebody on the bus. Give ``config`` for a service of rpod, ``sensors`` for another party's driver."""

    role: str
    """Role of its certificate; ``rpod pki show`` lists the roles."""
    config: Path | None = None
    """Configuration file of the service; its sensors, prefix and extra topics become rights."""
    sensors: tuple[SensorGrant, ...] = ()
    """Sensors that it publishes, if there is no configuration file."""
    router: Name = "router"
    """Name of the router to which it connects; two hosts have a router each."""


class RosServiceGrant(Config):
    """A ROS 2 service on the secure bus; without a grant there is none."""

    server: Name
    """Member that serves it."""
    client: Name
    """The one member that may call it."""


class RightsConfig(Config):
    """Members of a facility and their rights."""

    domain: int = Field(default=0, ge=0, le=232)
    """ROS domain."""
    namespace: str = Field(default="", pattern=BUS_NAMESPACE)
    """ROS namespace without slashes at its ends."""
    members: dict[Name, MemberConfig]
    """Members by the name of their certificates, which is the instance's name on the bus."""
    ros_services: dict[str, RosServiceGrant] = Field(default_factory=dict)
    """Grants of ROS 2 services, by the service's name without leading slash."""

    @property
    def keys(self) -> Namespace:
        """Part of the key space that the facility uses."""
        return Namespace(self.domain, self.namespace)

    @model_validator(mode="after")
    def _services_are_between_members(self) -> Self:
        for name, grant in self.ros_services.items():
            for member in (grant.server, grant.client):
                if member not in self.members:
                    known = ", ".join(self.members)
                    raise ValueError(f"ros_services.{name}: {member!r} is no member; members has {known}")
        return self

    @model_validator(mode="after")
    def _two_routers_at_most(self) -> Self:
        if len(self.routers) > 2:
            raise ValueError(
                f"members connect to {', '.join(self.routers)}; at most two routers can be joined: correct "
                "the router of some members"
            )
        return self

    @property
    def routers(self) -> tuple[str, ...]:
        """Names of the routers to which members connect."""
        return tuple(sorted({member.router for member in self.members.values()}))
