"""Derives the members of a facility, and their access rules, from the configurations of its services."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from rpod_schemas.config.base import load
from rpod_schemas.config.driver import DriverConfig
from rpod_schemas.config.emulator import EmulatorConfig, MotionServiceConfig
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.config.facility.logger import LoggerConfig
from rpod_schemas.config.facility.proxy import ProxyConfig
from rpod_schemas.config.facility.rights import MemberConfig, RightsConfig, SensorGrant
from rpod_schemas.config.facility.view import ViewConfig
from rpod_schemas.config.service import ServiceConfig
from rpod_schemas.errors import ConfigurationError
from rpod_security.certificates import Identity
from rpod_security.errors import RulesError
from rpod_security.roles import LINK, ROLES, Member, needs_sensors
from rpod_security.rules import OtherHost, RosService, Rules

MODELS: dict[str, type[ServiceConfig]] = {
    "motion": MotionServiceConfig,
    "emulator": EmulatorConfig,
    "driver": DriverConfig,
    "estimator": EstimatorConfig,
    "logger": LoggerConfig,
    "view": ViewConfig,
    "proxy": ProxyConfig,
}
"""Models of the configurations of those roles that are services of rpod."""


def member_of(name: str, role: str, config: ServiceConfig | None = None) -> Member:
    """Return a member with the rights that follow from its service's configuration."""
    extra: tuple[str, ...] = ()
    sensors: tuple[SensorGrant, ...] = ()
    if isinstance(config, EstimatorConfig):
        sensors = tuple(
            SensorGrant(kind=each.kind, name=each.name, source=each.source) for each in config.sensors
        )
    elif isinstance(config, EmulatorConfig):
        sensors = tuple(SensorGrant(kind=each.kind, name=each.name) for each in config.sensors)
    elif isinstance(config, DriverConfig):
        sensors = (SensorGrant(kind=config.kind, name=config.name),)
    elif isinstance(config, LoggerConfig):
        extra = config.record_extra
    prefix = config.prefix if isinstance(config, EstimatorConfig) else "estimate"
    return Member(name, role, sensors, prefix, extra)


def rules_of(rights: RightsConfig, folder: Path, *, source: str) -> Rules:
    """Return the rules of members; paths are relative to ``folder``, ``source`` is for messages.

    Raises:
        ConfigurationError: a member, or the configuration that it names, is wrong.
        RulesError: two members would publish the same.
    """
    members = [
        _member(name, member, rights, folder, source=f"{source}: members.{name}")
        for name, member in rights.members.items()
    ]
    services = [RosService(name, each.server, each.client) for name, each in rights.ros_services.items()]
    return Rules(rights.keys, members, services)


def _member(name: str, member: MemberConfig, rights: RightsConfig, folder: Path, *, source: str) -> Member:
    if member.role not in ROLES:
        raise ConfigurationError(
            source, "role", f"is {member.role!r}, must be one of {', '.join(sorted(ROLES))}"
        )
    if member.config is not None:
        return _by_configuration(name, member, rights, folder / member.config, source=source)
    if needs_sensors(member.role) and not member.sensors:
        raise ConfigurationError(
            source, "sensors", f"is empty, but a {member.role} publishes sensors; name them, or give config"
        )
    return Member(name, member.role, member.sensors)


def _by_configuration(
    name: str, member: MemberConfig, rights: RightsConfig, file: Path, *, source: str
) -> Member:
    if member.role not in MODELS:
        raise ConfigurationError(source, "config", f"belongs to no {member.role}; leave it out")
    config = load(MODELS[member.role], file)
    if config.instance != name:
        raise ConfigurationError(source, "config", f"is of the instance {config.instance!r}; name it so here")
    if config.bus.keys != rights.keys:
        raise ConfigurationError(
            source, "config", f"has another bus.domain or bus.namespace than {rights.keys}"
        )
    return member_of(name, member.role, config)


def other_host(rights: RightsConfig, router: str, identities: Iterable[Identity]) -> OtherHost | None:
    """Return who is on the other host, as one router has to know it; None if there is one router.

    The other router is known by its certificate and by those of the role ``link``.

    Raises:
        RulesError: no member connects to the router, or there is no certificate for the link.
    """
    if router not in rights.routers:
        raise RulesError(router, f"is no member's router; members name {', '.join(rights.routers)}")
    others = [name for name in rights.routers if name != router]
    if not others:
        return None
    known = [each for each in identities if each.name in others or each.role == LINK]
    if not any(each.role == LINK for each in known):
        raise RulesError(router, "no certificate joins the routers; make one with 'rpod pki issue link NAME'")
    members = frozenset(name for name, member in rights.members.items() if member.router in others)
    return OtherHost(members, tuple(each.common_name for each in known))


def named(rules: Rules, identities: Iterable[Identity]) -> Mapping[str, str]:
    """Return the common name of each member that has a certificate of its role.

    Raises:
        RulesError: a certificate of a member's name is of another role.
    """
    roles = {member.name: member.role for member in rules.members}
    found = {}
    for identity in identities:
        if roles.get(identity.name, identity.role) != identity.role:
            raise RulesError(
                identity.name, f"its certificate is of a {identity.role}, not of a {roles[identity.name]}"
            )
        if identity.name in roles:
            found[identity.name] = identity.common_name
    return found
