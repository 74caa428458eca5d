"""The verbs for a host that serves for long: keep a facility up, show it, end it, check the host."""

from pathlib import Path
from typing import Annotated

import typer

from rpod.options import JsonOption

host_verbs = typer.Typer(rich_markup_mode=None)

FacilityArgument = Annotated[
    Path, typer.Argument(metavar="FACILITY", help="The facility's file: YAML, TOML or JSON.")
]


@host_verbs.command()
def up(
    facility: FacilityArgument,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the state as one JSON line at each change.")
    ] = False,
) -> None:
    """Start the services of a facility and keep them alive. Ctrl-C, SIGTERM or 'rpod down' ends them."""
    from rpod.up.command import up_command

    raise typer.Exit(up_command(facility, as_json=as_json))


@host_verbs.command()
def ps(facility: FacilityArgument, as_json: JsonOption = False) -> None:
    """Show the services that 'rpod up' keeps alive. Exit 0 if all are at work, 1 if not."""
    from rpod.up.command import ps_command

    raise typer.Exit(ps_command(facility, as_json=as_json))


@host_verbs.command()
def down(facility: FacilityArgument, as_json: JsonOption = False) -> None:
    """Stop the services that 'rpod up' keeps alive. It waits until they have ended."""
    from rpod.up.command import down_command

    raise typer.Exit(down_command(facility, as_json=as_json))


@host_verbs.command()
def doctor(
    facility: Annotated[
        Path | None,
        typer.Argument(metavar="[FACILITY]", help="A facility's file, for its bus, its port and its logs."),
    ] = None,
    connect: Annotated[str | None, typer.Option("--connect", help="Zenoh endpoint of the router.")] = None,
    other_router: Annotated[
        str | None, typer.Option("--other-router", help="Endpoint of a second router, of another host.")
    ] = None,
    directory: Annotated[
        Path | None, typer.Option("--directory", help="Folder of the logs, whose disk is measured.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Check this host and say what to do.

    It checks clock, versions, disk, port and link. Exit 1 if a check fails.
    """
    from rpod.doctor.command import doctor_command

    raise typer.Exit(
        doctor_command(
            facility, connect=connect, other_router=other_router, directory=directory, as_json=as_json
        )
    )
