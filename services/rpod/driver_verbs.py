"""The verbs about sensors' drivers: list and run."""

from pathlib import Path
from typing import Annotated

import typer

driver_verbs = typer.Typer(
    name="driver",
    help="Run the drivers of real sensors.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@driver_verbs.callback()
def driver() -> None:
    """Run the drivers of real sensors."""


@driver_verbs.command("list")
def list_drivers(
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object only.")] = False,
) -> None:
    """List the drivers for 'rpod driver run', and how each was tested."""
    from rpod.command_driver import list_command

    raise typer.Exit(list_command(as_json=as_json))


@driver_verbs.command()
def run(
    name: Annotated[str, typer.Argument(help="Name of the driver; see 'rpod driver list'.")],
    config: Annotated[Path, typer.Argument(help="Configuration of driver and device: YAML, TOML or JSON.")],
    connect: Annotated[str | None, typer.Option("--connect", help="Zenoh endpoint of the router.")] = None,
    wait: Annotated[bool, typer.Option("--wait", help="Wait for the router as long as it takes.")] = False,
) -> None:
    """Publish the frames of a sensor: connect to its device, report its health, connect again."""
    from rpod.command_driver import run_command

    raise typer.Exit(run_command(name, config, connect=connect, wait=wait))
