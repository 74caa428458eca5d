"""The verbs that read logs: report, replay, recover."""

from pathlib import Path
from typing import Annotated

import typer

from rpod.options import JsonOption, NoLimits

log_verbs = typer.Typer()


def _given(context: typer.Context) -> list[str]:
    """Return the names of the options that the command line gives, also with the values of the defaults."""
    sources = {name: context.get_parameter_source(name) for name in context.params}
    return [name for name, source in sources.items() if source is not None and source.name == "COMMANDLINE"]


@log_verbs.command()
def report(
    logs: Annotated[
        list[Path],
        typer.Argument(help="MCAP files or folders; parts of one run are joined, several runs are compared."),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder to write to; by default that of the log.")
    ] = None,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Print the summary, or that of several runs, as one JSON object only."),
    ] = False,
    _no_limits: NoLimits = False,
) -> None:
    """Score a log, or compare several. It writes an HTML report and summary.json."""
    from rpod.logs.report import report_command

    raise typer.Exit(report_command(logs, out=out, as_json=as_json))


@log_verbs.command()
def replay(
    context: typer.Context,
    logs: Annotated[list[Path], typer.Argument(help="MCAP files, or a folder of them.")],
    config: Annotated[
        Path | None,
        typer.Option("--config", help="Configuration of the estimator; by default the one in the log."),
    ] = None,
    as_live: Annotated[
        bool, typer.Option("--as-live", help="Use exactly the frames that the live run used.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option("--out", help="Log to write; <log>.replay.mcap by default.")
    ] = None,
    bus: Annotated[
        bool, typer.Option("--bus", help="Play onto the bus instead of through the estimator.")
    ] = False,
    connect: Annotated[
        str | None, typer.Option("--connect", help="Endpoint of the router; it implies --bus.")
    ] = None,
    wait: Annotated[bool, typer.Option("--wait", help="Wait for the router; it implies --bus.")] = False,
    start: Annotated[float, typer.Option("--from", help="First second of the log to replay.")] = 0.0,
    end: Annotated[float | None, typer.Option("--to", help="Last second of the log to replay.")] = None,
    speed: Annotated[
        float, typer.Option("--speed", help="Speed relative to the recording, with --bus.")
    ] = 1.0,
    loop: Annotated[
        bool, typer.Option("--loop", help="Start again at the end of the log, with --bus.")
    ] = False,
    topics: Annotated[
        str | None, typer.Option("--topics", help="Topics to play, such as 'pmd/*,tf_static', with --bus.")
    ] = None,
    clock: Annotated[
        bool, typer.Option("--clock/--no-clock", help="Publish the time of the log, with --bus.")
    ] = True,
    as_json: JsonOption = False,
    _no_limits: NoLimits = False,
) -> None:
    """Replay a log through the estimator, or onto the bus.

    The estimator may have another configuration than it had in the log.
    """
    from rpod.logs.replay import BusOptions, bus_command, check_options, navigator_command

    onto_bus = bus or wait or connect is not None
    if code := check_options(_given(context), onto_bus=onto_bus):
        raise typer.Exit(code)
    if onto_bus:
        onto = BusOptions(connect, wait, speed=speed, loop=loop, topics=topics, clock=clock)
        raise typer.Exit(bus_command(logs, onto, start_s=start, end_s=end, as_json=as_json))
    raise typer.Exit(
        navigator_command(
            logs, config=config, as_live=as_live, out=out, start_s=start, end_s=end, as_json=as_json
        )
    )


@log_verbs.command("verify-log")
def verify_log(
    logs: Annotated[list[Path], typer.Argument(help="MCAP files, each with its chain beside it.")],
    authority: Annotated[
        Path | None,
        typer.Option("--authority", help="The authority's certificate, authority.pem of any credentials."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare logs with their digest chains. Exit 0 if they are as the logger wrote them."""
    from rpod.logs.verify import verify_log_command

    raise typer.Exit(verify_log_command(logs, authority=authority, as_json=as_json))


@log_verbs.command()
def recover(
    log: Annotated[Path, typer.Argument(help="Truncated or damaged MCAP file; it is not changed.")],
    out: Annotated[
        Path | None, typer.Option("--out", help="File to write; <log>.recovered.mcap by default.")
    ] = None,
    as_json: JsonOption = False,
    _no_limits: NoLimits = False,
) -> None:
    """Recover a readable log from a truncated or damaged one."""
    from rpod.logs.recover import recover_command

    raise typer.Exit(recover_command(log, out=out, as_json=as_json))
