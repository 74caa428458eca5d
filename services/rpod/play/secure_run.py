"""``rpod run --secure``: the same facility, with certificates, and with rules made of its configuration."""

import json
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from rpod.play.facility import Facility
from rpod_schemas.config.service import ServiceConfig
from rpod_security.certificates import Identity
from rpod_security.credentials import IDENTITY, Credentials
from rpod_security.errors import CredentialsError
from rpod_security.facility import member_of, named
from rpod_security.rules import Rules

ServiceT = TypeVar("ServiceT", bound=ServiceConfig)
ROLES = {
    "motion": "motion",
    "emulator": "emulator",
    "estimator": "estimator",
    "logger": "logger",
    "view": "view",
    "proxy": "proxy",
    "supervisor": "operator",
}
"""Role of each client of a run, by its name: what ``rpod pki issue all`` issues."""


def secured(facility: Facility, pki: Path, *, rules: Path) -> Facility:
    """Return the facility of a secure bus, and write its access rules.

    Args:
        facility: configurations of a plain bus.
        pki: folder that ``rpod pki init`` made.
        rules: file to write.

    Raises:
        CredentialsError: a service has no usable credentials.
        RulesError: a certificate is of another role.
        OSError: the rules cannot be written.
    """
    services = {verb: _certified(config, pki) for verb, config in facility.services.items()}
    supervisor, view, proxy = _certified(facility.supervisor, pki), facility.view, facility.proxy
    clients: list[ServiceConfig] = [*services.values(), supervisor]
    if (pki / view.instance).exists():  # without a certificate a run has no view
        view = _certified(view, pki)
        clients.append(view)
    if proxy is not None:
        proxy = _certified(proxy, pki)
        clients.append(proxy)
    _write_rules(clients, pki, rules)
    secure = {"listen": _by_tls(facility.router.listen), "credentials": pki / "router"}
    router = facility.router.model_copy(update=secure | {"rules": rules, "estimators": ()})
    Credentials.read(pki / "router")
    return replace(facility, router=router, services=services, supervisor=supervisor, view=view, proxy=proxy)


def _certified(config: ServiceT, pki: Path) -> ServiceT:
    """Return a client with its credentials.

    A client whose link passes through the proxy connects to that one's port. The proxy passes the encrypted
    bytes on, so that the client sees the router's certificate, whose names have no port.
    """
    credentials = {"connect": _by_tls(config.bus.connect), "credentials": pki / config.instance}
    return config.model_copy(update={"bus": config.bus.model_copy(update=credentials)})


def _by_tls(endpoint: str) -> str:
    return endpoint.replace("tcp/", "tls/", 1)


def _write_rules(clients: list[ServiceConfig], pki: Path, file: Path) -> None:
    members = [member_of(client.instance, ROLES[client.instance], client) for client in clients]
    rules = Rules(clients[0].bus.keys, members)
    access_control = rules.access_control(named(rules, [_identity(pki / each.name) for each in members]))
    file.parent.mkdir(exist_ok=True)
    file.write_text(json.dumps(access_control, indent=1), "utf-8")


def _identity(folder: Path) -> Identity:
    if not (folder / IDENTITY).exists():
        remedy = "run 'rpod pki init', then 'rpod pki issue all', which issues what is missing"
        raise CredentialsError(folder, f"{IDENTITY} is missing", remedy)
    return Credentials.read(folder).identity
