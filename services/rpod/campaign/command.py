"""``rpod campaign NAME`` from its options to its exit code."""

import json
import math
import platform
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from signal import SIGHUP, SIGTERM
from typing import Any

from rich.table import Table as RichTable

from rpod import __version__
from rpod.campaign.progress import CampaignProgress
from rpod.console import table_console
from rpod.errors import EXIT_INTERRUPTED, failed
from rpod.scenarios import find as find_scenario
from rpod.scenarios import shipped
from rpod_campaign.catalogue import find
from rpod_campaign.engine import CampaignError, Options, Section
from rpod_campaign.engine.errors import CampaignUnknownError, TrialFailedError
from rpod_campaign.engine.executor import Executor
from rpod_campaign.engine.executor.pool import ProcessPool
from rpod_campaign.engine.report.models import models_section
from rpod_campaign.engine.report.page import write_page
from rpod_campaign.engine.run import prepare, run_campaign
from rpod_runtime.process.lifecycle import EXIT_OK, EXIT_USAGE
from rpod_runtime.process.load import cores
from rpod_schemas.config.base import check
from rpod_schemas.errors import ConfigurationError

_PLAIN_WIDTH = 200


def campaign_command(
    name: str,
    *,
    options: dict[str, Any],
    jobs: int | None,
    out: Path,
    as_json: bool,
    cluster: str | None = None,
) -> int:
    """Run a campaign, or its remaining trials, and write its report; return the exit code.

    Args:
        name: name of the campaign.
        options: values of the command line, by name of the option; None for an option that is not given.
        jobs: number of processes; one for each core if None.
        out: folder of all campaigns.
        as_json: print the cells as one JSON object, and at most a line of progress a minute.
        cluster: address of a Dask scheduler, or ``local:N``; None for processes of this machine.
    """
    try:
        executor = _executor(jobs, cluster)
        campaign = find(name)
        prepared = prepare(campaign, _options(name, campaign.options, options), out=out, version=__version__)
    except CampaignUnknownError as error:
        return failed("campaign", error, EXIT_USAGE)
    except (ConfigurationError, CampaignError, OSError) as error:
        return failed("campaign", error)
    try:
        with _every_signal_interrupts(), CampaignProgress(prepared, as_json=as_json) as progress:
            results = run_campaign(prepared, executor(progress.note), on_trial=progress.one)
        sections = [*models_section(prepared.cells), *prepared.campaign.sections(results)]
        machine = {**executor(progress.note).described(), "machine": platform.machine()}
        report = write_page(prepared, sections, version=__version__, machine=machine)
    except KeyboardInterrupt:
        return failed(
            "campaign",
            f"interrupted; the finished trials are kept in {prepared.folder.path}; repeat it to continue",
            EXIT_INTERRUPTED,
        )
    except TrialFailedError as error:
        if not error.expected:
            print(error.trace, end="", file=sys.stderr)
        return failed("campaign", error)
    except (CampaignError, OSError) as error:
        return failed("campaign", error)
    if as_json:
        told: dict[str, Any] = {"cells": [_plain(result.summary) for result in results]}
        if campaign.totals is not None:
            told["totals"] = _plain(campaign.totals(results))
        print(json.dumps(told, indent=2, allow_nan=False))
    else:
        _print(sections, report, prepared.folder.trials_file)
    return EXIT_OK


@contextmanager
def _every_signal_interrupts() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the process as an interrupt does, so that no process of a trial is left."""
    before = {number: signal.signal(number, signal.default_int_handler) for number in (SIGTERM, SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _options(name: str, model: type[Options], given: Mapping[str, Any]) -> Options:
    """Return the options of the command line; lists are separated by commas. Raises ConfigurationError."""
    fields = model.model_fields
    document: dict[str, Any] = {}
    for option, value in given.items():
        if value is None:
            continue
        if option not in fields:
            raise ConfigurationError(_flag(option), "", f"has no meaning for {name}; leave it out")
        default = fields[option].get_default(call_default_factory=True)
        is_list = isinstance(default, tuple) or "tuple" in str(fields[option].annotation)
        document[option] = tuple(part.strip() for part in value.split(",")) if is_list else value
    if "scenarios" in fields:
        files = [name for name in document.get("scenario", ()) if Path(name).is_file()]
        document["scenarios"] = {scenario: find_scenario(scenario) for scenario in (*shipped(), *files)}
    try:
        return check(model, document, source="")
    except ConfigurationError as error:
        option = error.field.split(".")[0]
        if option not in given:  # of several options together
            raise ConfigurationError(name, "", error.reason) from error
        value = repr(given[option])
        reason = error.reason if value in error.reason else f"{error.reason} ({value})"
        raise ConfigurationError(_flag(option), "", reason) from error


def _flag(option: str) -> str:
    return f"--{option.replace('_', '-')}"


def _executor(jobs: int | None, cluster: str | None) -> Callable[[Callable[[str], None]], Executor]:
    """Return the function that creates the executor; its argument prints notes. Raises ConfigurationError."""
    if jobs is not None and jobs < 1:
        raise ConfigurationError("--jobs", "", f"is {jobs}; it must be at least 1")
    if cluster is None:
        return lambda _: ProcessPool(jobs or cores())
    if jobs is not None:
        raise ConfigurationError(
            "--jobs", "", "has no meaning with --cluster, which has workers of its own; leave it out"
        )
    from rpod_campaign.engine.executor.cluster import Cluster, check_address  # noqa: PLC0415 - an extra

    check_address(cluster)
    return lambda note: Cluster(cluster, note=note)


def _print(sections: Sequence[Section], report: Path, trials: Path) -> None:
    console = table_console(plain_width=_PLAIN_WIDTH)
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
    """Return a summary for JSON, in which NaN and infinity are null, also in the objects that it holds."""
    return {
        key: _plain(value)
        if isinstance(value, Mapping)
        else None
        if isinstance(value, float) and not math.isfinite(value)
        else value
        for key, value in summary.items()
    }
