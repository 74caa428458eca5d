"""The verbs about certificates: init, issue, renew, revoke, rules, show, audit."""

from pathlib import Path
from typing import Annotated

import typer

from rpod.options import JsonOption

pki_verbs = typer.Typer(
    name="pki",
    no_args_is_help=True,
    rich_markup_mode=None,
)

FolderOption = Annotated[Path, typer.Option("--pki", help="Folder of the authority and of all credentials.")]
DaysOption = Annotated[float, typer.Option("--days", help="Validity, days.", min=1e-5, max=36500)]
HostOption = Annotated[
    list[str] | None,
    typer.Option("--host", help="Name or address under which clients reach the router; may be repeated."),
]
RouterHostOption = Annotated[
    list[str] | None,
    typer.Option(
        "--host",
        help="Name or address under which clients reach the router; may be repeated; only for the role "
        "router.",
    ),
]
_FOLDER = Path("pki")


@pki_verbs.callback()
def pki() -> None:
    """Certificates and access rules for a secure bus."""


@pki_verbs.command()
def init(host: HostOption = None, days: DaysOption = 3650, folder: FolderOption = _FOLDER) -> None:
    """Make an authority and the router's certificate. Keep FOLDER/authority off the router's host."""
    from rpod.pki.command import init_command

    raise typer.Exit(init_command(folder, hosts=host or (), days=days))


@pki_verbs.command()
def issue(
    role: Annotated[
        str, typer.Argument(help="Role, as 'rpod pki show' lists them; all: those of 'rpod run'.")
    ],
    name: Annotated[
        str | None,
        typer.Argument(
            help="Name of the service on the bus (its `instance`); that of the role by default. Not with "
            "'all'."
        ),
    ] = None,
    host: RouterHostOption = None,
    days: DaysOption = 365,
    folder: FolderOption = _FOLDER,
) -> None:
    """Issue the certificate of a service. Its folder goes to the service's host."""
    from rpod.pki.command import issue_command

    raise typer.Exit(issue_command(folder, role, name, hosts=host or (), days=days))


@pki_verbs.command()
def request(
    role: Annotated[str, typer.Argument(help="Role, as 'rpod pki show' lists them.")],
    folder: Annotated[Path, typer.Argument(help="Folder of the credentials, named as the instance.")],
) -> None:
    """Make a key on this host, and a request for its certificate. The request goes to the authority."""
    from rpod.pki.command import request_command

    raise typer.Exit(request_command(folder, role))


@pki_verbs.command()
def sign(
    request: Annotated[Path, typer.Argument(help="Request, made by 'rpod pki request'.")],
    host: RouterHostOption = None,
    days: DaysOption = 365,
    renew: Annotated[
        bool, typer.Option("--renew", help="The request is from the host that has the name already.")
    ] = False,
    folder: FolderOption = _FOLDER,
) -> None:
    """Issue a certificate for a key of another host, or renew it. The request states name and role."""
    from rpod.pki.command import sign_command

    raise typer.Exit(sign_command(folder, request, hosts=host or (), days=days, renews=renew))


@pki_verbs.command()
def accept(
    signed: Annotated[Path, typer.Argument(help="Folder that 'rpod pki sign' made.")],
    folder: Annotated[Path, typer.Argument(help="Folder of the credentials, which holds the key already.")],
) -> None:
    """Complete credentials with a signed certificate."""
    from rpod.pki.command import accept_command

    raise typer.Exit(accept_command(signed, folder))


@pki_verbs.command()
def renew(
    names: Annotated[
        list[str] | None, typer.Argument(help="Names; those that end within 30 days by default.")
    ] = None,
    days: DaysOption = 365,
    folder: FolderOption = _FOLDER,
) -> None:
    """Replace certificates before they end. Running services take the new ones by themselves."""
    from rpod.pki.command import renew_command

    raise typer.Exit(renew_command(folder, names or (), days=days))


@pki_verbs.command()
def revoke(
    names: Annotated[list[str], typer.Argument(help="Names whose rights end.")],
    folder: FolderOption = _FOLDER,
) -> None:
    """Revoke credentials. Then make the rules again and restart the router."""
    from rpod.pki.command import revoke_command

    raise typer.Exit(revoke_command(folder, names))


@pki_verbs.command()
def rules(
    members: Annotated[
        Path | None,
        typer.Argument(
            help="File of the members with their configurations; without one, as 'rpod run' has them."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="File to write; standard output by default.")
    ] = None,
    router: Annotated[
        str, typer.Option("--router", help="Name of the router, where two hosts have one each.")
    ] = "router",
    folder: FolderOption = _FOLDER,
) -> None:
    """Make the router's access rules. They follow from the configuration and the valid certificates."""
    from rpod.pki.command import rules_command

    raise typer.Exit(rules_command(folder, members, out=out, router=router))


@pki_verbs.command()
def show(folder: FolderOption = _FOLDER, as_json: JsonOption = False) -> None:
    """List certificates with roles and ends, and all roles."""
    from rpod.pki.command import show_command

    raise typer.Exit(show_command(folder, as_json=as_json))


@pki_verbs.command()
def audit(
    record: Annotated[Path, typer.Argument(help="Audit record: audit.jsonl of a folder of credentials.")],
) -> None:
    """Check that an audit record was not changed."""
    from rpod.pki.command import audit_command

    raise typer.Exit(audit_command(record))
