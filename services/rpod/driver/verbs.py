"""The verbs for drivers: run one, check a live sensor, write a new driver, list drivers and faults."""

from pathlib import Path
from typing import Annotated

import typer

from rpod.options import JsonOption

driver_verbs = typer.Typer(
    name="driver",
    help="Run the driver of a sensor, check it, or write a new one.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

AgainstOption = Annotated[
    str | None,
    typer.Option(
        "--against",
        help="Prefix of the estimate of another sensor alone, to compare the mounts of both.",
    ),
]
SearchOption = Annotated[
    bool,
    typer.Option(
        "--search",
        help="Search for the target in some frames, also mirrored, in other units and with other lenses. "
        "It needs --target, and may take some minutes.",
    ),
]


@driver_verbs.command("list")
def list_drivers(
    as_json: JsonOption = False,
) -> None:
    """List the drivers for 'rpod driver run', and how each was tested."""
    from rpod.driver.command import list_command

    raise typer.Exit(list_command(as_json=as_json))


@driver_verbs.command()
def run(
    name: Annotated[str, typer.Argument(help="Name of the driver; see 'rpod driver list'.")],
    config: Annotated[Path, typer.Argument(help="Configuration of driver and device: YAML, TOML or JSON.")],
    connect: Annotated[str | None, typer.Option("--connect", help="Zenoh endpoint of the router.")] = None,
    wait: Annotated[bool, typer.Option("--wait", help="Wait for the router as long as it takes.")] = False,
) -> None:
    """Publish the frames of a sensor. It reports the device's health, and connects again after a failure."""
    from rpod.driver.command import run_command

    raise typer.Exit(run_command(name, config, connect=connect, wait=wait))


@driver_verbs.command()
def check(
    name: Annotated[str, typer.Argument(help="Name of the sensor: the first part of its topics.")] = "pmd",
    kind: Annotated[
        str | None,
        typer.Option(
            "--kind", help="Kind of the sensor; by default that with which the name begins, or pmd."
        ),
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", help="Configuration of the driver, for name, kind and bus.")
    ] = None,
    source: Annotated[
        Path | None,
        typer.Option(
            "--source", help="File that describes how another party's driver publishes; see deploy/sensors."
        ),
    ] = None,
    connect: Annotated[str | None, typer.Option("--connect", help="Zenoh endpoint of the router.")] = None,
    duration: Annotated[float, typer.Option("--duration", help="Time to watch, s.")] = 30.0,
    rate: Annotated[float | None, typer.Option("--rate", help="Nominal rate of the sensor, Hz.")] = None,
    target: Annotated[
        str | None,
        typer.Option(
            "--target",
            help="Name or file of the target in view. With truth on the bus, stamps, ranges, mount and "
            "mirroring are checked too.",
        ),
    ] = None,
    against: AgainstOption = None,
    search: SearchOption = False,
    wait: Annotated[bool, typer.Option("--wait", help="Wait for the router as long as it takes.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Watch a live sensor and say what is wrong. Exit 0 if nothing is, 1 if a line fails."""
    from rpod.driver.check import CheckOptions, check_command

    options = CheckOptions(
        name,
        kind,
        config=config,
        source=source,
        connect=connect,
        rate_hz=rate,
        target=target,
        against=against,
        wait=wait,
        search=search,
    )
    raise typer.Exit(check_command(options, duration_s=duration, as_json=as_json))


@driver_verbs.command()
def new(
    template: Annotated[str, typer.Argument(help="Template: ifm, ros or custom.")],
    name: Annotated[str, typer.Argument(help="Name of the package, as my_camera.")],
    out: Annotated[
        Path, typer.Option("--out", help="Folder in which the package's folder is made.")
    ] = Path(),
) -> None:
    """Write the package of a new driver. Its driver, configuration, tests and systemd unit run at once."""
    from rpod.driver.command import new_command

    raise typer.Exit(new_command(template, name, out=out))


@driver_verbs.command()
def faults(
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON list only.")] = False,
) -> None:
    """List the faults of messages, scene, links, processes and disk.

    'rpod driver check' names those of messages; scenarios and queries may ask for any.
    """
    from rpod.driver.command import faults_command

    raise typer.Exit(faults_command(as_json=as_json))
