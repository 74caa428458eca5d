"""``rpod campaign`` from its options to its exit code."""

import json
import math
import platform
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from signal import SIGHUP, SIGTERM
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table as RichTable

from rpod import __version__
from rpod.command_run import EXIT_INTERRUPTED
from rpod.scenarios import find, shipped
from rpod_analysis import AnalysisError
from rpod_campaign.catalogue import CAMPAIGNS
from rpod_campaign.engine import AnyCampaign, Options, Prepared, Section, prepare, run_campaign
from rpod_campaign.engine.page import write_page
from rpod_campaign.engine.pool import cores
from rpod_runtime.lifecycle import EXIT_FAILURE, EXIT_OK, EXIT_USAGE
from rpod_schemas.config.base import check
from rpod_schemas.errors import ConfigurationError
from rpod_target import TargetError

_PLAIN_PERIOD_S, _PLAIN_WIDTH = 10.0, 200
_SPEED_PERIOD_S = 600.0
"""Over which the time left is estimated: trials of one cell may take a hundred times those of another."""
_LISTS = ("ranges", "steps", "scan_steps", "method", "target", "matcher", "scenario", "radius", "case")


def campaign_command(
    name: str, *, options: dict[str, Any], jobs: int | None, out: Path, as_json: bool
) -> int:
    """Run a campaign, or what is left of it, write its report; return the exit code."""
    try:
        processes = _jobs(jobs)
        prepared = prepare(_campaign(name), _options(options), out=out, version=__version__)
    except ConfigurationError as error:
        return _fail(error, EXIT_USAGE)
    except (TargetError, AnalysisError, OSError) as error:
        return _fail(error, EXIT_FAILURE)
    try:
        with _every_signal_interrupts(), _Told(prepared, quiet=as_json) as told:
            results = run_campaign(prepared, jobs=processes, told=told.one)
        sections = prepared.campaign.sections(results)
        report = write_page(prepared, sections, version=__version__, machine=_machine(processes))
    except KeyboardInterrupt:
        return _fail(f"interrupted; what is done is kept in {prepared.folder.path}", EXIT_INTERRUPTED)
    except (AnalysisError, OSError) as error:
        return _fail(error, EXIT_FAILURE)
    if as_json:
        print(
            json.dumps({"cells": [_plain(result.summary) for result in results]}, indent=2, allow_nan=False)
        )
    else:
        _tell(sections, report, prepared.folder.trials_file)
    return EXIT_OK


@contextmanager
def _every_signal_interrupts() -> Iterator[None]:
    """Let the signals that end a process end it as an interrupt does, so that no trial's process is left."""
    before = {number: signal.signal(number, signal.default_int_handler) for number in (SIGTERM, SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _campaign(name: str) -> AnyCampaign:
    if name not in CAMPAIGNS:
        raise ConfigurationError("campaign", "", f"needs {', '.join(CAMPAIGNS)}, not {name!r}")
    return CAMPAIGNS[name]


def _options(given: dict[str, Any]) -> Options:
    """Return what the command line says; lists are separated by commas."""
    document = {name: value for name, value in given.items() if value is not None}
    for name in _LISTS:
        if name in document:
            document[name] = tuple(part.strip() for part in document[name].split(","))
    document["scenarios"] = {scenario: find(scenario) for scenario in shipped()}
    try:
        return check(Options, document, source="")
    except ConfigurationError as error:
        option = error.field.split(".")[0]
        name = option.replace("_", "-")
        raise ConfigurationError(f"--{name}", "", f"{error.reason} ({given[option]!r})") from error


def _jobs(jobs: int | None) -> int:
    if jobs is not None and jobs < 1:
        raise ConfigurationError("--jobs", "", f"needs at least 1, not {jobs}")
    return jobs or cores()


class _Told:
    """The progress on standard error: a bar on a terminal, a line now and then elsewhere, else nothing."""

    def __init__(self, prepared: Prepared, *, quiet: bool) -> None:
        self._prepared, self._done = prepared, len(prepared.done)
        self._resumed = self._done
        self._console = Console(stderr=True, quiet=quiet)
        self._begin_s = self._said_s = time.monotonic()
        self._bar: Progress | None = None
        self._show: Callable[[], None] = self._say

    def __enter__(self) -> "_Told":
        prepared = self._prepared
        self._console.print(_beginning(prepared), soft_wrap=True, highlight=False)
        if self._console.is_terminal and not self._console.quiet:
            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeElapsedColumn(),
                TimeRemainingColumn(),
                console=self._console,
                transient=True,
                speed_estimate_period=_SPEED_PERIOD_S,
            )
            self._bar.start()
            bar = self._bar
            task = bar.add_task(prepared.campaign.name, total=prepared.total, completed=self._done)
            self._show = lambda: bar.update(task, completed=self._done)
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar:
            self._bar.stop()

    def one(self, _: int) -> None:
        """Count a trial."""
        self._done += 1
        self._show()

    def _say(self) -> None:
        now_s, total = time.monotonic(), self._prepared.total
        if now_s - self._said_s < _PLAIN_PERIOD_S:
            return
        self._said_s = now_s
        each_s = (now_s - self._begin_s) / (self._done - self._resumed)
        left_min = each_s * (total - self._done) / 60.0
        self._console.print(f"{self._done} of {total} trials, {left_min:.1f} min left", highlight=False)


def _beginning(prepared: Prepared) -> str:
    """Return whether the campaign begins or goes on, and if it begins, why it does not go on."""
    path = prepared.folder.path
    if prepared.done:
        return f"resuming {path}: {len(prepared.done)} of {prepared.total} trials are there"
    other = prepared.folder.most_alike()
    because = f"; {other[0].name} beside it differs in {', '.join(other[1])}" if other else ""
    return f"beginning {path}{because}"


def _tell(sections: Sequence[Section], report: Path, trials: Path) -> None:
    console = Console()
    console = console if console.is_terminal else Console(width=_PLAIN_WIDTH)
    for section in sections:
        console.print(f"\n{section.title}", style="bold")
        if section.note:
            console.print(section.note, style="dim", highlight=False)
        for table in section.tables:
            shown = RichTable(title=table.title or None, title_justify="left")
            for column in table.columns:
                shown.add_column(column, overflow="fold")
            for row in table.rows:
                shown.add_row(*row)
            console.print(shown)
    console.print(f"report   {report}", soft_wrap=True, highlight=False)
    console.print(f"trials   {trials}", soft_wrap=True, highlight=False)


def _plain(summary: Any) -> dict[str, Any]:
    """Return a summary as JSON has it: what is no number is null."""
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in summary.items()
    }


def _machine(processes: int) -> dict[str, str]:
    return {"processes": f"{processes} on {cores()} cores", "machine": platform.machine()}


def _fail(reason: Exception | str, code: int) -> int:
    print(f"rpod campaign: {reason}", file=sys.stderr)
    return code
