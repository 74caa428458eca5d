"""``rpod run`` from its arguments to its exit code."""

import sys
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from rpod.errors import EXIT_INTERRUPTED, InterruptedRunError, RunError, failed, told
from rpod.play.beforehand import too_fast, unseen
from rpod.play.facility import Speed
from rpod.play.joint_motion import beyond
from rpod.play.progress import Progress
from rpod.play.run import RunFolder, play
from rpod.scenarios import find
from rpod_runtime import BusError
from rpod_runtime.process.lifecycle import EXIT_OK, configure_logging
from rpod_schemas.config.base import check
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.summary import Summary
from rpod_security.errors import SecurityError
from rpod_target import check_model, load_target

if TYPE_CHECKING:
    from rpod_analysis.report import ReportPaths


LEAST_LOGGED = 0.9
"""Least share of a run that its log has to contain. Numerics: without a fault it misses a frame at most."""


def run_command(
    name: str,
    *,
    duration_s: float | None,
    speed: str,
    seed: int | None,
    out: Path,
    view: bool,
    pki: Path | None,
    as_json: bool,
) -> int:
    """Play and score a scenario, and print the paths of log and report; return the exit code.

    With ``pki``, a folder of certificates, the bus is secure.
    """
    configure_logging("supervisor")
    if view and find_spec("rerun") is None:
        print("rpod run: no view, because it needs rerun-sdk: pip install 'rpod[view]'", file=sys.stderr)
        view = False
    try:
        scenario, pace = _scenario(name, duration_s=duration_s, seed=seed), _speed(speed)
        # built once here, so that the services find them in the cache
        target = load_target(scenario.target)
        check_model(target, load_target(scenario.model))
        said = (*unseen(scenario, target.radius_m), too_fast(scenario), *beyond(scenario, target))
        for text in filter(None, said):
            print(f"rpod run: {text}", file=sys.stderr)
        folder = _folder(out, scenario)
    except (ConfigurationError, RunError, OSError) as error:
        return failed("run", error)
    try:
        with Progress(quiet=as_json) as progress:
            play(scenario, folder, speed=pace, progress=progress, view=view, pki=pki, meanwhile=_load_report)
            progress.say("writing the report")
            paths = _report(folder)
    except (InterruptedRunError, KeyboardInterrupt):
        return _fail("interrupted", folder, EXIT_INTERRUPTED)
    except (ConfigurationError, RunError, BusError, SecurityError, OSError) as error:
        return _fail(error, folder)
    summary = Summary.model_validate_json(paths.summary.read_text("utf-8"))
    if as_json:
        print(summary.model_dump_json(indent=2))
    else:
        _print(summary, paths)
    if early := ends_early(summary.duration_s, scenario.duration_s):
        return failed("run", RunError(early))
    return EXIT_OK


def ends_early(logged_s: float, duration_s: float) -> str:
    """Return what is wrong and the remedy if a log ends well before its run; empty otherwise."""
    if logged_s >= LEAST_LOGGED * duration_s:
        return ""
    return (
        f"the log ends after {logged_s:.1f} of {duration_s:g} s, and so do the figures; a warning of the "
        "logger above says why (a full disk, for example): correct this and run again"
    )


def _folder(out: Path, scenario: Scenario) -> RunFolder:
    """Return the new folder of a run. Raises ``RunError``."""
    try:
        return RunFolder.make(out, scenario)
    except OSError as error:
        raise RunError(f"--out: {told(error)}") from error


def _load_report() -> None:
    """Load the code that writes the report, in the time in which the services stop: it takes a second."""
    with suppress(ImportError):  # told when the report is written
        import rpod_analysis.report  # noqa: F401, PLC0415


def _report(folder: RunFolder) -> "ReportPaths":
    """Write the report of a run. Raises ``RunError``."""
    from rpod_analysis import AnalysisError  # noqa: PLC0415
    from rpod_analysis.report import write_report  # noqa: PLC0415

    try:
        return write_report(folder.logs)
    except AnalysisError as error:
        raise RunError(str(error)) from error


def _scenario(name: str, *, duration_s: float | None, seed: int | None) -> Scenario:
    """Return the scenario with the changes of the command line."""
    scenario = find(name)
    changes = {"duration_s": duration_s, "seed": seed}
    document = dict(scenario) | {key: value for key, value in changes.items() if value is not None}
    return check(Scenario, document, source=name)


def _speed(speed: str) -> Speed:
    if speed == "1":
        return "1"
    if speed == "max":
        return "max"
    raise ConfigurationError("--speed", "", f"is {speed!r}; it must be 1 or max")


def _print(summary: Summary, paths: "ReportPaths") -> None:
    from rpod.summary_table import print_summary  # noqa: PLC0415 - it needs what the report loads

    console = Console(markup=False)
    print_summary(summary, console)
    console.print(f"log      {summary.log}", soft_wrap=True, highlight=False)
    console.print(f"report   {paths.html}", soft_wrap=True, highlight=False)


def _fail(reason: Exception | str, folder: RunFolder, code: int | None = None) -> int:
    code = failed("run", reason, code)
    if folder.log.exists():
        print(f"log      {folder.log}", file=sys.stderr)
        print(f"next     rpod report {folder.log}", file=sys.stderr)
    return code
