"""``rpod pki`` from its arguments to its exit code."""

import json
import re
import socket
import sys
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from functools import wraps
from ipaddress import ip_address
from pathlib import Path
from typing import ParamSpec

from rich.console import Console
from rich.table import Table

from rpod.errors import failed
from rpod.play.secure_run import ROLES as OF_A_RUN
from rpod_runtime.process.lifecycle import EXIT_OK
from rpod_schemas.config.base import load
from rpod_schemas.config.facility.rights import MemberConfig, RightsConfig, SensorGrant
from rpod_schemas.errors import ConfigurationError
from rpod_security.audit import check
from rpod_security.authority import FOLDER, Authority, Entry
from rpod_security.credentials import AUTHORITY, IDENTITY, WARN_BEFORE, accept_certificate, write_request
from rpod_security.errors import SecurityError
from rpod_security.facility import named, other_host, rules_of
from rpod_security.roles import ROLES, ROUTER

P = ParamSpec("P")
_ALL = "all"
"""In the place of a role: the roles of all services of a run."""
_LOCAL = "localhost", "127.0.0.1", "::1"
_HOST = r"[A-Za-z0-9_]([A-Za-z0-9_.-]*[A-Za-z0-9_])?"
"""Pattern of a host's name."""
_PUBLISH = {"emulator": (SensorGrant(kind="pmd", name="pmd"), SensorGrant(kind="lidar", name="lidar"))}
"""Sensors of the standard scenarios, by the member of a run that publishes them."""


def _with_exit_code(body: Callable[P, None]) -> Callable[P, int]:
    """Turn the errors of a verb into one line and an exit code."""

    @wraps(body)
    def command(*args: P.args, **kwargs: P.kwargs) -> int:
        try:
            body(*args, **kwargs)
        except (ConfigurationError, SecurityError) as error:
            return failed("pki", error)
        except OSError as error:
            about = f"{error.filename}: " if error.filename is not None else ""
            return failed("pki", f"{about}{error.strerror or error}")
        return EXIT_OK

    return command


@_with_exit_code
def init_command(folder: Path, *, hosts: Sequence[str], days: float) -> None:
    """Make an authority and the router's certificate."""
    validity, named_hosts = timedelta(days=days), _hosts(hosts)
    authority = Authority.create(folder, validity=validity)
    router = authority.issue(ROUTER, ROUTER, validity=validity, hosts=named_hosts)
    print(f"{folder / FOLDER}: the authority. Keep it off the router's host: it can certify any name")
    print(f"{router}: the router's credentials, for {', '.join(named_hosts)}")


def _hosts(given: Sequence[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys((*_LOCAL, socket.gethostname(), *_checked(given))))


def _checked(hosts: Sequence[str]) -> tuple[str, ...]:
    """Return names and addresses of hosts. Raises ``ConfigurationError``: no client can reach one of them."""
    for host in hosts:
        try:
            ip_address(host)
        except ValueError as error:
            if not re.fullmatch(_HOST, host):
                reason = (
                    f"is {host!r}; needs the name or the address of a host, without a port, as lab-router"
                )
                raise ConfigurationError("--host", "", reason) from error
    return tuple(hosts)


@_with_exit_code
def issue_command(folder: Path, role: str, name: str | None, *, hosts: Sequence[str], days: float) -> None:
    """Issue the credentials of one name, or of all that ``rpod run`` needs and that have none yet."""
    _check_issue(role, name, hosts)
    authority = Authority.open(folder)
    wanted = {name or role: role}
    if role == _ALL:
        taken = {entry.name for entry in authority.valid}
        wanted = {each: its for each, its in OF_A_RUN.items() if each not in taken}
    for each, its in wanted.items():
        named_hosts = _hosts(hosts) if its == ROUTER else _checked(hosts)
        made = authority.issue(its, each, validity=timedelta(days=days), hosts=named_hosts)
        print(f"{made}: credentials of {each}, a {its}; copy the folder to its host")


def _check_issue(role: str, name: str | None, hosts: Sequence[str]) -> None:
    """Check the arguments of ``rpod pki issue``. Raises ``ConfigurationError``."""
    if role != _ALL and role not in ROLES:
        raise ConfigurationError(
            "role", "", f"{role!r} is unknown; choose {_ALL}, or one of {', '.join(sorted(ROLES))}"
        )
    if role == _ALL and name is not None:
        raise ConfigurationError("name", "", f"is {name!r}; 'all' gives each name itself, so leave it out")
    if hosts and role != ROUTER:
        raise ConfigurationError("--host", "", f"is only for the role {ROUTER}; leave it out for {role!r}")


@_with_exit_code
def request_command(folder: Path, role: str) -> None:
    """Make a key and a request for its certificate."""
    if role not in ROLES:
        raise ConfigurationError("role", "", f"{role!r} is unknown; choose one of {', '.join(sorted(ROLES))}")
    request = write_request(folder.absolute(), role)
    print(f"{request}: send it to the authority; the key stays here")


@_with_exit_code
def sign_command(
    folder: Path, request: Path, *, hosts: Sequence[str], days: float, renews: bool = False
) -> None:
    """Issue the certificate of a request."""
    authority = Authority.open(folder)
    made = authority.certify(
        request.read_bytes(), validity=timedelta(days=days), hosts=_checked(hosts), renews=renews
    )
    (entry,) = [entry for entry in authority.entries if entry.name == made.name]
    print(f"{made}: certificate of {entry.name}, role {entry.role}: {ROLES[entry.role].title}")
    print(f"copy the folder back, and 'rpod pki accept' it there; else 'rpod pki revoke {entry.name}'")


@_with_exit_code
def accept_command(signed: Path, folder: Path) -> None:
    """Complete the credentials of a key that waits for its certificate."""
    accept_certificate(folder, (signed / AUTHORITY).read_bytes(), (signed / IDENTITY).read_bytes())
    print(f"{folder}: credentials")


@_with_exit_code
def renew_command(folder: Path, names: Sequence[str], *, days: float) -> None:
    """Renew the certificates of some names, or all that end soon."""
    authority = Authority.open(folder)
    soon = datetime.now(UTC) + WARN_BEFORE
    for name in names or [entry.name for entry in authority.valid if entry.ends < soon]:
        made = authority.renew(name, validity=timedelta(days=days))
        print(f"{made}: renewed; copy the folder to its host before the old certificate ends")


@_with_exit_code
def revoke_command(folder: Path, names: Sequence[str]) -> None:
    """Revoke names."""
    authority = Authority.open(folder)
    for name in names:
        authority.revoke(name)
        print(f"{name}: revoked; it has rights until the router restarts with new rules ('rpod pki rules')")


@_with_exit_code
def rules_command(folder: Path, members: Path | None, *, out: Path | None, router: str) -> None:
    """Write the access rules of a router for the valid certificates."""
    authority = Authority.open(folder)
    if members:
        rights, place = load(RightsConfig, members), members
    else:
        members_of_a_run = {
            name: MemberConfig(role=role, sensors=_PUBLISH.get(name, ())) for name, role in OF_A_RUN.items()
        }
        rights, place = RightsConfig(members=members_of_a_run), Path("rpod run")
    rules = rules_of(rights, place.parent, source=str(place))
    identities = [entry.identity for entry in authority.valid]
    names = named(rules, identities)
    text = json.dumps(rules.access_control(names, other_host(rights, router, identities)), indent=1) + "\n"
    if out:
        out.write_text(text, "utf-8")
    else:
        print(text, end="")
    for member in rules.members:
        if member.name not in names:
            print(f"rpod pki: {member.name} has no valid certificate, so it gets no rights", file=sys.stderr)


@_with_exit_code
def show_command(folder: Path, *, as_json: bool) -> None:
    """List what was issued."""
    authority = Authority.open(folder)
    if as_json:
        document = {
            "authority_ends": authority.ends.isoformat(),
            "names": [entry.model_dump(mode="json") for entry in authority.entries],
            "roles": {name: role.title for name, role in ROLES.items()},
        }
        print(json.dumps(document, indent=2))
        return
    table = Table("name", "role", "common name", "state", box=None)
    for entry in authority.entries:
        table.add_row(entry.name, entry.role, entry.identity.common_name, _state(entry))
    console = Console(markup=False)
    console.print(table)
    console.print(f"authority: ends {authority.ends:%Y-%m-%d}\nroles:", highlight=False)
    for name, role in ROLES.items():
        console.print(f"  {name:10} {role.title}", highlight=False, soft_wrap=True)


def _state(entry: Entry) -> str:
    if entry.revoked:
        return f"revoked {entry.revoked:%Y-%m-%d}"
    left = entry.ends - datetime.now(UTC)
    when = f"{entry.ends:%Y-%m-%d}"
    if left < timedelta(0):
        return f"expired {when}"
    return f"ends {when}" + (f", in {left.days} days" if left < WARN_BEFORE else "")


@_with_exit_code
def audit_command(record: Path) -> None:
    """Check an audit record."""
    print(f"{record}: {check(record)} lines; each before the last one is as it was written")
