"""The command line: parses, loads configurations, runs, and turns errors into exit codes."""

import sys
from collections.abc import Callable
from pathlib import Path
from threading import Event
from typing import Annotated, Any, NoReturn, TypeVar

import typer
from pydantic import BaseModel

from rpod import __version__
from rpod.log_verbs import log_verbs
from rpod_runtime.lifecycle import EXIT_FAILURE, EXIT_USAGE
from rpod_runtime.lifecycle import run as run_service
from rpod_schemas.config.base import check, read_document
from rpod_schemas.errors import ConfigurationError

ConfigT = TypeVar("ConfigT", bound=BaseModel)

app = typer.Typer(
    name="rpod",
    help="A rendezvous laboratory in software, behind a message bus.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

ConfigOption = Annotated[
    Path | None, typer.Option("--config", help="Configuration file: YAML, TOML or JSON.")
]
ConnectOption = Annotated[str | None, typer.Option("--connect", help="Zenoh endpoint of the router.")]
WaitOption = Annotated[bool, typer.Option("--wait", help="Wait for the router as long as it takes.")]


def main() -> None:
    """Run the command line; a verb of an extra that is not installed says which package it lacks."""
    try:
        app()
    except ModuleNotFoundError as error:
        print(f"rpod: this verb needs {error.name}: pip install 'rpod[all]'", file=sys.stderr)
        sys.exit(EXIT_FAILURE)


def _refuse(error: ConfigurationError) -> NoReturn:
    """Say in one line which field is wrong, and why."""
    print(f"rpod: {error}", file=sys.stderr)
    raise typer.Exit(EXIT_USAGE)


def _version(asked: bool) -> None:
    if asked:
        print(f"rpod {__version__}")
        raise typer.Exit


app.add_typer(log_verbs)


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Say it.")
    ] = False,
) -> None:
    """A rendezvous laboratory in software, behind a message bus."""


def _serve(
    verb: str,
    model: type[ConfigT],
    body: Callable[..., None],
    *,
    config: Path | None,
    changes: dict[str, Any] | None = None,
    **bus: Any,
) -> NoReturn:
    """Load a service's configuration, with what the command line says on top, and run it."""
    from rpod_target import TargetError

    source = config or f"rpod {verb}"
    try:
        document = (read_document(config) if config else {}) | (changes or {})
        configured = document.get("bus") or {}
        if isinstance(configured, dict):  # else the check below says what is wrong with it
            document["bus"] = configured | {key: value for key, value in bus.items() if value}
        checked = check(model, document, source=source)
    except ConfigurationError as error:
        _refuse(error)

    def serve(stop: Event) -> None:
        try:
            body(checked, version=__version__, stop=stop)
        except TargetError as error:
            raise ConfigurationError(source, "target", str(error)) from error

    raise typer.Exit(run_service(verb, serve))


@app.command()
def router(
    config: ConfigOption = None,
    listen: Annotated[str | None, typer.Option("--listen", help="Zenoh endpoint to listen on.")] = None,
) -> None:
    """The bus: a Zenoh router that keeps the truth from the estimators."""
    from rpod_runtime import router as daemon
    from rpod_schemas.config.service import RouterConfig

    try:
        document = read_document(config) if config else {}
        document |= {"listen": listen} if listen else {}
        checked = check(RouterConfig, document, source=config or "rpod router")
    except ConfigurationError as error:
        _refuse(error)
    raise typer.Exit(run_service("router", lambda stop: daemon.run(checked, stop=stop)))


@app.command()
def motion(config: ConfigOption = None, connect: ConnectOption = None, wait: WaitOption = False) -> None:
    """Trajectories: publishes the truth."""
    from rpod_motion import daemon
    from rpod_schemas.config.emulator import MotionServiceConfig

    _serve("motion", MotionServiceConfig, daemon.run, config=config, connect=connect, wait=wait)


@app.command()
def emulator(config: ConfigOption = None, connect: ConnectOption = None, wait: WaitOption = False) -> None:
    """The sensors: truth in, sensor messages out."""
    from rpod_emulator import daemon
    from rpod_schemas.config.emulator import EmulatorConfig

    _serve("emulator", EmulatorConfig, daemon.run, config=config, connect=connect, wait=wait)


@app.command()
def estimator(config: ConfigOption = None, connect: ConnectOption = None, wait: WaitOption = False) -> None:
    """Poses from sensor messages."""
    from rpod_estimator import daemon
    from rpod_schemas.config.estimator import EstimatorConfig

    _serve("estimator", EstimatorConfig, daemon.run, config=config, connect=connect, wait=wait)


@app.command()
def logger(config: ConfigOption = None, connect: ConnectOption = None, wait: WaitOption = False) -> None:
    """Everything on the bus into MCAP."""
    from rpod_logger import daemon
    from rpod_schemas.config.logger import LoggerConfig

    _serve("logger", LoggerConfig, daemon.run, config=config, connect=connect, wait=wait)


@app.command()
def view(
    logs: Annotated[
        list[Path] | None, typer.Argument(help="MCAP files to look at; the bus where left out.")
    ] = None,
    config: ConfigOption = None,
    connect: ConnectOption = None,
    wait: WaitOption = False,
    target: Annotated[
        str | None, typer.Option("--target", help="Whose mesh and wireframe are drawn.")
    ] = None,
    web: Annotated[
        bool | None,
        typer.Option("--web/--native", help="A web page or a window; by the display if left out."),
    ] = None,
    bind: Annotated[str | None, typer.Option("--bind", help="Address of the viewer; 127.0.0.1.")] = None,
    save: Annotated[
        Path | None, typer.Option("--save", help="Recording (.rrd) to write instead of a viewer.")
    ] = None,
    start: Annotated[float, typer.Option("--from", help="Of a log: seconds from its beginning.")] = 0.0,
    end: Annotated[float | None, typer.Option("--to", help="Of a log: seconds from its beginning.")] = None,
) -> None:
    """Look at the facility, or at a log: images, scene, errors, state."""
    from rpod.command_view import view_log
    from rpod_schemas.config.view import ViewConfig

    changes = {"target": target, "bind": bind, "save": save}
    changes["viewer"] = None if web is None else "web" if web else "native"
    given = {name: value for name, value in changes.items() if value is not None}
    if logs:
        raise typer.Exit(view_log(logs, config=config, changes=given, start_s=start, end_s=end))
    from rpod_view import daemon
    from rpod_view.scheduling import lower_priority

    lower_priority()
    _serve("view", ViewConfig, daemon.run, config=config, changes=given, connect=connect, wait=wait)


@app.command()
def scenarios() -> None:
    """List what can be run."""
    from rpod.scenarios import find, shipped

    for name in shipped():
        print(f"{name:18} {find(name).title}")


@app.command()
def run(
    scenario: Annotated[str, typer.Argument(help="Name or file; see 'rpod scenarios'.")] = "mockup-tumbling",
    duration: Annotated[float | None, typer.Option("--duration", help="Seconds of scenario time.")] = None,
    speed: Annotated[str, typer.Option("--speed", help="1 by the wall clock, max in lockstep.")] = "1",
    seed: Annotated[int | None, typer.Option("--seed", help="Of all noise.")] = None,
    out: Annotated[Path, typer.Option("--out", help="Where the run's folder is made.")] = Path("runs"),
    with_view: Annotated[bool, typer.Option("--view", help="Open the live view.")] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the summary as one JSON object only.")
    ] = False,
) -> None:
    """Play a scenario through all services, and score it."""
    from rpod.command_run import run_command

    code = run_command(
        scenario, duration_s=duration, speed=speed, seed=seed, out=out, view=with_view, as_json=as_json
    )
    raise typer.Exit(code)


@app.command()
def campaign(
    name: Annotated[
        str,
        typer.Argument(
            help="lidar-acquisition, -trajectory, -verdict, -tracking, -robustness, -range; "
            "pmd-tracking, -sun, -robustness, -acquisition."
        ),
    ],
    trials: Annotated[int | None, typer.Option("--trials", help="Of each cell.")] = None,
    ranges: Annotated[str | None, typer.Option("--ranges", help="In m, for example 20,50.")] = None,
    steps: Annotated[
        str | None, typer.Option("--steps", help="Of the templates, deg: 60,40,30,20,10.")
    ] = None,
    scan_steps: Annotated[
        str | None, typer.Option("--scan-steps", help="Of the scan, deg: 1,0.5,0.2,0.1.")
    ] = None,
    method: Annotated[str | None, typer.Option("--method", help="One or several, with commas.")] = None,
    target: Annotated[str | None, typer.Option("--target", help="One or several, with commas.")] = None,
    seed: Annotated[int | None, typer.Option("--seed", help="Of all randomness.")] = None,
    eq4: Annotated[
        str | None, typer.Option("--eq4", help="Of the 2015 paper: usual, printed or both.")
    ] = None,
    sampling: Annotated[
        str | None, typer.Option("--sampling", help="Of the attitudes: euler, so3 or both.")
    ] = None,
    centroid: Annotated[
        str | None, typer.Option("--centroid", help="Of template matching: plain, offset or both.")
    ] = None,
    matcher: Annotated[
        str | None, typer.Option("--matcher", help="ICP after template matching, with commas.")
    ] = None,
    scenario: Annotated[
        str | None, typer.Option("--scenario", help="Of the camera, with commas: oblique,tumbling,approach.")
    ] = None,
    radius: Annotated[
        str | None, typer.Option("--radius", help="Of the paper's neighbour search, px: 10,25,50.")
    ] = None,
    frames: Annotated[
        str | None, typer.Option("--frames", help="Of a sequence: keyframes (one a second), full or both.")
    ] = None,
    through: Annotated[
        str | None,
        typer.Option("--through", help="First guess of a frame: tracker, truth, navigator or both."),
    ] = None,
    depth: Annotated[
        str | None, typer.Option("--depth", help="Of the camera: raw, calibrated or both.")
    ] = None,
    case: Annotated[
        str | None,
        typer.Option("--case", help="Of pmd-robustness, -sun, -acquisition, -verdict, with commas."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Where the campaign's folder is made.")] = Path(
        "campaigns"
    ),
    jobs: Annotated[int | None, typer.Option("--jobs", help="Processes; all cores where left out.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the cells as one JSON object only.")] = False,
) -> None:
    """Monte-Carlo trials of the methods, beside the papers."""
    from rpod.command_campaign import campaign_command

    options = {
        "trials": trials,
        "ranges": ranges,
        "steps": steps,
        "scan_steps": scan_steps,
        "method": method,
        "target": target,
        "seed": seed,
        "eq4": eq4,
        "sampling": sampling,
        "centroid": centroid,
        "matcher": matcher,
        "scenario": scenario,
        "radius": radius,
        "frames": frames,
        "through": through,
        "depth": depth,
        "case": case,
    }
    raise typer.Exit(campaign_command(name, options=options, jobs=jobs, out=out, as_json=as_json))


@app.command()
def bench(
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object only.")] = False,
) -> None:
    """Measure the speed of this machine."""
    from rpod.bench import bench_command

    raise typer.Exit(bench_command(as_json=as_json))


if __name__ == "__main__":
    main()
