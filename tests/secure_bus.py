"""A secure bus for tests: an authority, a router with a facility's rules, clients of any certificate."""

import json
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

import zenoh

from rpod_runtime import Node
from rpod_runtime.bus.session import free_endpoint, open_client, open_router
from rpod_schemas.config.facility.rights import SensorGrant
from rpod_schemas.config.service import BusConfig, RouterConfig, ServiceConfig
from rpod_schemas.topics import Namespace
from rpod_security.authority import Authority
from rpod_security.facility import named
from rpod_security.roles import ROLES, ROUTER, Member
from rpod_security.rules import RosService, Rules

KEYS = Namespace()
SENSORS = {
    "emulator": (SensorGrant(kind="pmd", name="pmd"), SensorGrant(kind="lidar", name="lidar")),
    "driver": (SensorGrant(kind="pmd", name="cam"),),
}
"""Sensors that members publish; the driver's is another than the emulator's."""
LEFT_OUT = ("replay", "link")
"""Roles that no facility has beside those whose place they take."""
SERVICE = RosService("set_mode", "estimator", "operator")


def members() -> list[Member]:
    """Return one member a role, with the role's name."""
    return [
        Member(role, role, SENSORS.get(role, ())) for role in ROLES if role != ROUTER and role not in LEFT_OUT
    ]


class SecureBus:
    """A router with rules; certificates are in ``pki``."""

    def __init__(self, folder: Path) -> None:
        self.pki = folder / "pki"
        self.authority = Authority.create(self.pki)
        self.authority.issue(ROUTER, ROUTER, hosts=("localhost", "127.0.0.1"))
        for member in members():
            self.authority.issue(member.role, member.name)
        self.rules_file = folder / "rules.json"
        self.endpoint = free_endpoint().replace("tcp/", "tls/")
        self.write_rules()

    def write_rules(self) -> None:
        """Write the rules for the certificates that are valid now."""
        rules = Rules(KEYS, members(), [SERVICE])
        names = named(rules, [entry.identity for entry in self.authority.valid])
        self.rules_file.write_text(json.dumps(rules.access_control(names)), "utf-8")

    def open_router(self) -> zenoh.Session:
        """Open the router."""
        return open_router(self.router_config())

    def router_config(self) -> RouterConfig:
        """Return the router's configuration."""
        return RouterConfig(
            listen=self.endpoint, credentials=self.pki / ROUTER, rules=self.rules_file, estimators=()
        )

    def bus(self, name: str, **changes: Any) -> BusConfig:
        """Return the connection of a client with the certificate of a name."""
        return BusConfig(connect=self.endpoint, credentials=self.pki / name, **changes)

    def client(self, name: str) -> zenoh.Session:
        """Open a bare client."""
        return open_client(self.bus(name))

    def node(self, name: str) -> Node:
        """Return a node, not yet opened."""
        return Node(ServiceConfig(instance=name, bus=self.bus(name)), version="test")

    def stranger(self, folder: Path, role: str, name: str, *, days: float = 1.0) -> BusConfig:
        """Return the connection of a client whose certificate is of another authority."""
        credentials = Authority.create(folder).issue(role, name, validity=timedelta(days=days))
        return BusConfig(connect=self.endpoint, credentials=credentials)


@contextmanager
def secure_bus(folder: Path) -> Iterator[SecureBus]:
    """Run a router for one client of each role."""
    bus = SecureBus(folder)
    with ExitStack() as stack:
        stack.enter_context(bus.open_router())
        yield bus
