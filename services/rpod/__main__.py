"""The command line: parses, loads configurations, runs, and turns errors into exit codes."""

import faulthandler
import gc
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from pkgutil import resolve_name
from threading import Event
from typing import Annotated, Any, NoReturn, TypeVar

import typer
from pydantic import BaseModel
from typer.core import TyperGroup

from rpod import __version__
from rpod.calibrate.verbs import calibrate_verbs
from rpod.campaign.verbs import campaign_verbs
from rpod.deferred_imports import import_when_used
from rpod.driver.verbs import driver_verbs
from rpod.host_verbs import host_verbs
from rpod.logs.verbs import log_verbs
from rpod.options import JsonOption, NoLimits
from rpod.pki.verbs import pki_verbs
from rpod.reloading import run_reloading, with_bus
from rpod.target.verbs import target_verbs
from rpod_runtime.process.collector import process_has_started, process_starts
from rpod_runtime.process.lifecycle import EXIT_FAILURE, EXIT_USAGE
from rpod_schemas.config.base import check, read_document
from rpod_schemas.errors import ConfigurationError

ConfigT = TypeVar("ConfigT", bound=BaseModel)
_FIRST_VERBS = ("run", "scenarios", "report", "view", "replay", "target", "campaign", "calibrate", "driver")
"""The verbs that a new user needs; the help lists them before the others."""


class _VerbGroup(TyperGroup):
    """All verbs, in the order in which a new user needs them."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all verbs."""
        others = [name for name in super().list_commands(ctx) if name not in _FIRST_VERBS]
        return [*_FIRST_VERBS, *others]


app = typer.Typer(
    name="rpod",
    cls=_VerbGroup,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

ConfigOption = Annotated[
    Path | None, typer.Option("--config", help="Configuration file: YAML, TOML or JSON.")
]
ConnectOption = Annotated[str | None, typer.Option("--connect", help="Zenoh endpoint of the router.")]
CredentialsOption = Annotated[
    Path | None,
    typer.Option("--credentials", help="Folder of certificate and key, made by 'rpod pki issue'."),
]
WaitOption = Annotated[bool, typer.Option("--wait", help="Wait for the router as long as it takes.")]


def main() -> None:
    """Run the command line; a verb whose extra is not installed names the missing package."""
    if sys.__stderr__ is not None:
        faulthandler.enable(sys.__stderr__)  # a crash of compiled code tells in which call
    process_starts()
    import_when_used("numpy.f2py", "numpy.testing")
    try:
        app()
    except ModuleNotFoundError as error:
        print(f"rpod: this verb needs {error.name}: pip install 'rpod[all]'", file=sys.stderr)
        sys.exit(EXIT_FAILURE)
    finally:
        process_has_started()
        gc.freeze()  # else the interpreter examines all objects of all libraries at its end, for up to 0.7 s


def _refuse(verb: str, error: ConfigurationError) -> NoReturn:
    """Print one line with the verb, the wrong field and the reason; exit."""
    told = str(error)
    print(told if told.startswith("rpod ") else f"rpod {verb}: {told}", file=sys.stderr)
    raise typer.Exit(EXIT_USAGE)


def _version(asked: bool) -> None:
    if asked:
        print(f"rpod {__version__}")
        raise typer.Exit


app.add_typer(log_verbs)
app.add_typer(calibrate_verbs, name="calibrate")
app.add_typer(campaign_verbs)
app.add_typer(target_verbs)
app.add_typer(pki_verbs)
app.add_typer(driver_verbs)
app.add_typer(host_verbs)


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Play, record and score a rendezvous: sensors, pose estimation and a logger on a message bus."""


_EXAMPLES = {
    "estimator": "docs/tutorials/your-camera.md",
    "motion": "config/motion.json in the folder of any run",
    "emulator": "config/emulator.json in the folder of any run",
    "proxy": "services/rpod_proxy/README.md",
}
"""Places with a configuration of a service that has fields without a default, by its verb."""


def _check_required(model: type[BaseModel], given: Mapping[str, Any], verb: str) -> None:
    """Raise ``ConfigurationError`` if a service without a file lacks fields that have no default."""
    fields = model.model_fields.items()
    needed = [f"`{name}`" for name, field in fields if field.is_required() and name not in given]
    if not needed:
        return
    *others, last = needed
    told = f"{', '.join(others)} and {last}" if others else last
    example = f" (example: {_EXAMPLES[verb]})" if verb in _EXAMPLES else ""
    raise ConfigurationError(f"rpod {verb}", "", f"no configuration: give --config FILE with {told}{example}")


def _serve(
    verb: str,
    model: type[ConfigT],
    body: Callable[..., None],
    *,
    config: Path | None,
    changes: dict[str, Any] | None = None,
    **bus: Any,
) -> NoReturn:
    """Load a service's configuration, apply the options of the command line, and run the service."""
    source = config or f"rpod {verb}"

    def read() -> ConfigT:
        document = (read_document(config) if config else {}) | (changes or {})
        return check(model, with_bus(document, bus), source=source)

    try:
        if config is None:
            _check_required(model, changes or {}, verb)
        checked = read()
    except ConfigurationError as error:
        _refuse(verb, error)

    def serve(stop: Event) -> None:
        try:
            body(checked, version=__version__, stop=stop)
        except ConfigurationError as error:
            from rpod_target import TargetError

            if isinstance(error, TargetError):
                raise ConfigurationError(source, "target", str(error)) from error
            raise

    raise typer.Exit(run_reloading(verb, serve, checked, read if config else None))


@app.command()
def router(
    config: ConfigOption = None,
    listen: Annotated[str | None, typer.Option("--listen", help="Zenoh endpoint to listen on.")] = None,
    credentials: CredentialsOption = None,
    rules: Annotated[
        Path | None, typer.Option("--rules", help="File of access rules, made by 'rpod pki rules'.")
    ] = None,
) -> None:
    """Run the bus, a Zenoh router. It does not pass the truth to the estimators."""
    from rpod_runtime.bus import router as daemon
    from rpod_schemas.config.service import RouterConfig

    def read() -> RouterConfig:
        document = read_document(config) if config else {}
        given = {"listen": listen, "credentials": credentials, "rules": rules}
        document |= {field: value for field, value in given.items() if value}
        return check(RouterConfig, document, source=config or "rpod router")

    try:
        checked = read()
    except ConfigurationError as error:
        _refuse("router", error)

    def body(stop: Event) -> None:
        daemon.run(checked, stop=stop)

    raise typer.Exit(run_reloading("router", body, checked, read if config else None))


def _add_service(verb: str, model: str, does: str) -> None:
    """Add the verb of a service, whose code is loaded when it is called."""

    def serve(
        config: ConfigOption = None,
        connect: ConnectOption = None,
        wait: WaitOption = False,
        credentials: CredentialsOption = None,
    ) -> None:
        body, configuration = (resolve_name(name) for name in (f"rpod_{verb}.daemon:run", model))
        _serve(verb, configuration, body, config=config, connect=connect, wait=wait, credentials=credentials)

    app.command(verb, help=does)(serve)


_add_service(
    "motion",
    "rpod_schemas.config.emulator:MotionServiceConfig",
    "Publish the truth: the trajectory of the target.",
)
_add_service(
    "emulator",
    "rpod_schemas.config.emulator:EmulatorConfig",
    "Emulate the sensors: publish their messages from the truth.",
)
_add_service(
    "estimator", "rpod_schemas.config.estimator:EstimatorConfig", "Estimate poses from sensor messages."
)
_add_service(
    "logger",
    "rpod_schemas.config.facility.logger:LoggerConfig",
    "Record everything on the bus into MCAP files.",
)
_add_service(
    "proxy",
    "rpod_schemas.config.facility.proxy:ProxyConfig",
    "Pass links on to the router, with faults on request.",
)


TargetOption = Annotated[
    str | None, typer.Option("--target", help="Target whose mesh and wireframe are drawn.")
]
WebOption = Annotated[
    bool | None,
    typer.Option(
        "--web/--native", help="Show a web page or a window; by default a window if there is a display."
    ),
]
BindOption = Annotated[
    str | None, typer.Option("--bind", help="Address on which the viewer listens; 127.0.0.1 by default.")
]
TokenOption = Annotated[
    Path | None,
    typer.Option("--token-file", help="File of the token for --bind on the network; made if not there."),
]
SaveOption = Annotated[
    Path | None, typer.Option("--save", help="Recording (.rrd) to write instead of a viewer.")
]


@app.command()
def view(
    logs: Annotated[
        list[Path] | None, typer.Argument(help="MCAP files to show; without one, the bus is shown.")
    ] = None,
    config: ConfigOption = None,
    connect: ConnectOption = None,
    wait: WaitOption = False,
    credentials: CredentialsOption = None,
    target: TargetOption = None,
    web: WebOption = None,
    bind: BindOption = None,
    token_file: TokenOption = None,
    save: SaveOption = None,
    start: Annotated[float, typer.Option("--from", help="First second of a log to show.")] = 0.0,
    end: Annotated[float | None, typer.Option("--to", help="Last second of a log to show.")] = None,
    _no_limits: NoLimits = False,
) -> None:
    """Show the facility or a log: images, scene, errors, state."""
    from rpod.command_view import view_log
    from rpod_schemas.config.facility.view import ViewConfig

    changes = {"target": target, "bind": bind, "token_file": token_file, "save": save}
    changes["viewer"] = None if web is None else "web" if web else "native"
    given = {name: value for name, value in changes.items() if value is not None}
    if logs:
        raise typer.Exit(view_log(logs, config=config, changes=given, start_s=start, end_s=end))
    from rpod_view import daemon
    from rpod_view.viewer.scheduling import lower_priority

    lower_priority()
    _serve(
        "view",
        ViewConfig,
        daemon.run,
        config=config,
        changes=given,
        connect=connect,
        wait=wait,
        credentials=credentials,
    )


@app.command()
def scenarios() -> None:
    """List the scenarios for 'rpod run'."""
    from rpod.scenarios import find, shipped

    for name in shipped():
        print(f"{name:18} {find(name).title}")


@app.command()
def run(
    scenario: Annotated[
        str, typer.Argument(help="Name or file of a scenario; see 'rpod scenarios'.")
    ] = "mockup-tumbling",
    duration: Annotated[
        float | None,
        typer.Option(
            "--duration",
            help="Length of the run, s of scenario time; by default that of the scenario. An approach is "
            "played faster or slower to fit.",
        ),
    ] = None,
    speed: Annotated[str, typer.Option("--speed", help="Speed: 1 for real time, max for lockstep.")] = "1",
    seed: Annotated[int | None, typer.Option("--seed", help="Seed of all noise.")] = None,
    out: Annotated[Path, typer.Option("--out", help="Folder in which the run's own folder is made.")] = Path(
        "runs"
    ),
    with_view: Annotated[bool, typer.Option("--view", help="Open the live view.")] = False,
    secure: Annotated[
        bool,
        typer.Option(
            "--secure", help="Encrypt, and give each service the rights of its role; see 'rpod pki'."
        ),
    ] = False,
    pki: Annotated[Path, typer.Option("--pki", help="Folder of the certificates, with --secure.")] = Path(
        "pki"
    ),
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the summary as one JSON object only.")
    ] = False,
) -> None:
    """Play a scenario through all services, and score it."""
    from rpod.play.command import run_command

    code = run_command(
        scenario,
        duration_s=duration,
        speed=speed,
        seed=seed,
        out=out,
        view=with_view,
        pki=pki if secure else None,
        as_json=as_json,
    )
    raise typer.Exit(code)


@app.command("compile")
def compile_kernels() -> None:
    """Compile the numerical code. It takes minutes on a new machine, seconds afterwards."""
    from rpod.command_compile import compile_command

    raise typer.Exit(compile_command())


@app.command()
def bench(
    as_json: JsonOption = False,
) -> None:
    """Measure the speed of this machine."""
    from rpod.bench import bench_command

    raise typer.Exit(bench_command(as_json=as_json))


if __name__ == "__main__":
    main()
