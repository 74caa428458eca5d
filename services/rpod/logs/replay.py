"""``rpod replay`` from its arguments to its exit code."""

import json
import logging
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from math import inf
from pathlib import Path
from threading import Event

import numpy as np
from rich.console import Console
from rich.table import Table

from rpod import __version__
from rpod.errors import failed
from rpod.options import check_part
from rpod_analysis import AnalysisError, Log, open_log
from rpod_analysis.replay import Playback, Played, Replayed, compare, configured_estimator, play, replay
from rpod_analysis.scoring.row_store import Column
from rpod_analysis.scoring.totals import summarise_durations
from rpod_runtime import Node
from rpod_runtime.process.lifecycle import EXIT_FAILURE, EXIT_OK, EXIT_USAGE
from rpod_runtime.process.lifecycle import run as run_service
from rpod_schemas.config.base import check, load
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.config.service import BusConfig, ServiceConfig
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.replay import ReplayReport, Side
from rpod_schemas.rmw.cdr import NANOSECONDS

log = logging.getLogger(__name__)

_INSTANCE = "replay"
_TOLD_EVERY_S = 5.0


@dataclass(frozen=True)
class BusOptions:
    """Options for playing a log onto the bus."""

    connect: str | None
    wait: bool
    speed: float
    loop: bool
    topics: str | None
    clock: bool


_ONCE = "without it the log is replayed once through the estimator"
_NEED_BUS = {
    "loop": f"--loop: needs --bus; {_ONCE}",
    "speed": f"--speed: needs --bus; {_ONCE}, as fast as it can",
    "topics": "--topics: needs --bus; without it the estimator takes the topics of its own sensors",
    "clock": "--no-clock: needs --bus; without it nothing is published",
}
"""Refusals of options without ``--bus``, by name."""
_NO_BUS = {
    "config": "--config: is for a replay through the estimator, but --bus plays messages and runs none",
    "as_live": "--as-live: is for a replay through the estimator, but --bus plays messages and runs none",
    "out": "--out: is for a replay through the estimator, but --bus writes no log",
}
"""Refusals of options with ``--bus``, by name."""


def check_options(given: Sequence[str], *, onto_bus: bool) -> int:
    """Return 0 if the given options have an effect, else the exit code; the reason is printed."""
    refused = _NO_BUS if onto_bus else _NEED_BUS
    reason = next((refused[name] for name in given if name in refused), None)
    if reason is None:
        return EXIT_OK
    remedy = "; leave one of both out" if onto_bus else ""
    return failed("replay", reason + remedy, EXIT_USAGE)


def bus_command(
    logs: Sequence[Path], options: BusOptions, *, start_s: float, end_s: float | None, as_json: bool
) -> int:
    """Play a log onto the bus until its end or a signal; return the exit code."""
    try:
        config = _service(options)
        playback = Playback(
            speed=options.speed,
            start_s=start_s,
            end_s=end_s,
            loop=options.loop,
            topics=tuple((options.topics or "").split(",")) if options.topics else (),
            clock=options.clock,
        )
        if not 0.0 < playback.speed < inf:
            reason = f"is {playback.speed:g}; give a number above 0, 1 for the recorded speed"
            raise ConfigurationError("--speed", "", reason)
        check_part(start_s, end_s)
        opened = open_log(*logs)
    except (ConfigurationError, AnalysisError) as error:
        return failed("replay", error)
    outcome = EXIT_OK

    def serve(stop: Event) -> None:
        nonlocal outcome
        with Node(config, version=__version__, stop=stop) as node:
            node.ready(f"playing {opened.paths[0]}")
            try:
                played = play(opened, node, playback, stop=stop)
            except AnalysisError as error:
                log.error("%s", error)
                outcome = EXIT_FAILURE
            else:
                _print_played(played, as_json=as_json)

    with opened:
        return run_service(_INSTANCE, serve) or outcome


def _service(options: BusOptions) -> ServiceConfig:
    bus = {"wait": options.wait} | ({"connect": options.connect} if options.connect else {})
    document = {"instance": _INSTANCE, "bus": check(BusConfig, bus, source="--connect")}
    return check(ServiceConfig, document, source="rpod replay")


def _print_played(played: Played, *, as_json: bool) -> None:
    if as_json:
        print(json.dumps(asdict(played), indent=2))
        return
    for name, count in sorted(played.messages.items()):
        print(f"{name:30} {count}")
    for name in played.left_out:
        print(f"{name:30} left out: its message type is not known, or no key can have its name")
    print(f"at most {played.behind_s:.3f} s behind", file=sys.stderr)


def navigator_command(
    logs: Sequence[Path],
    *,
    config: Path | None,
    as_live: bool,
    out: Path | None,
    start_s: float,
    end_s: float | None,
    as_json: bool,
) -> int:
    """Run the estimator over a log in this process, and compare; return the exit code."""
    try:
        check_part(start_s, end_s)
        given = load(EstimatorConfig, config) if config else None
        with open_log(*logs) as opened:
            replayed = replay(
                opened,
                given or configured_estimator(opened),
                out=out,
                as_live=as_live,
                start_s=start_s,
                end_s=end_s,
                follow=_Progress(opened, quiet=as_json),
            )
            report = _report(opened, replayed, as_live=as_live)
    except (ConfigurationError, AnalysisError) as error:
        return failed("replay", error)
    if as_json:
        print(report.model_dump_json(indent=2))
    else:
        _print_report(report)
    return EXIT_OK


class _Progress:
    """Tells every five seconds how much of a log is replayed."""

    def __init__(self, opened: Log, *, quiet: bool) -> None:
        self._length_s, self._quiet = (opened.end_ns - opened.start_ns) / NANOSECONDS, quiet
        self._told_s = time.monotonic()

    def __call__(self, time_s: float) -> None:
        now_s = time.monotonic()
        if not self._quiet and now_s - self._told_s > _TOLD_EVERY_S:
            self._told_s = now_s
            print(f"{time_s:.1f} of {self._length_s:.1f} s of the log are replayed", file=sys.stderr)


def _report(opened: Log, replayed: Replayed, *, as_live: bool) -> ReplayReport:
    compared = compare(opened, replayed)
    return ReplayReport(
        log=str(opened.paths[0]),
        out=str(replayed.out),
        replaced=replayed.replaced,
        as_live=as_live,
        frames=replayed.frames,
        missing=replayed.missing,
        refused=replayed.refused,
        second_publisher=replayed.second_publisher,
        undivided=replayed.undivided,
        resets=replayed.resets,
        unknown_resets=replayed.unknown_resets,
        processing_s=summarise_durations(Column(np.array(replayed.processing_s))),
        old=compared.old,
        new=compared.new,
        difference=compared.difference,
    )


_ROWS: tuple[tuple[str, str, Callable[[Side], float | None]], ...] = (
    ("frames", ".0f", lambda side: side.frames),
    ("estimates", ".0f", lambda side: side.estimates),
    ("accepted", ".0f", lambda side: side.accepted),
    ("tracking share", ".3f", lambda side: side.modes.tracking_share),
    ("lost, s", ".1f", lambda side: side.lost_s),
    ("attitude RMS, deg", ".3f", lambda side: side.error.attitude_deg.rms if side.error else None),
    ("attitude max, deg", ".3f", lambda side: side.error.attitude_deg.max if side.error else None),
    ("position RMS, m", ".4f", lambda side: side.error.position_m.rms if side.error else None),
    ("position max, m", ".4f", lambda side: side.error.position_m.max if side.error else None),
    (
        "NEES within 95 %, share",
        ".3f",
        lambda side: side.consistency.nees_share_in_95 if side.consistency else None,
    ),
    ("misleading estimates", ".0f", lambda side: side.integrity.misleading if side.integrity else None),
    ("integrity alerts", ".0f", lambda side: side.integrity.alerts if side.integrity else None),
    ("available, share", ".3f", lambda side: side.integrity.availability if side.integrity else None),
)


def _cell(side: Side | None, form: str, of: Callable[[Side], float | None]) -> str:
    value = None if side is None else of(side)
    return "-" if value is None else format(value, form)


def _print_report(report: ReplayReport) -> None:
    console = Console(markup=False)
    table = Table(title=f"{report.frames} frames replayed", title_justify="left")
    table.add_column("", style="dim")
    for column in ("logged", "replayed"):
        table.add_column(column, justify="right")
    for name, form, of in _ROWS:
        table.add_row(name, _cell(report.old, form, of), _cell(report.new, form, of))
    console.print(table)
    if between := report.difference:
        console.print(
            f"{between.identical} of {between.common} common poses are identical; the largest difference is "
            f"{between.attitude_deg.max:.3g} deg and {1e3 * between.position_m.max:.3g} mm",
            highlight=False,
        )
    for note in _notes(report):
        console.print(note)
    console.print(f"log   {report.out}", soft_wrap=True, highlight=False)


def _notes(report: ReplayReport) -> Iterator[str]:
    if report.missing:
        yield f"{report.missing} frames of the live run are not in the log"
    for name, count in report.refused.items():
        yield f"{count} messages of {name} could not be used"
    for name, count in report.second_publisher.items():
        yield f"{count} messages of {name} are not used: another publisher held the topic"
    for name, publishers in report.undivided.items():
        told = "the log does not say which of them sent which message, so that all are used"
        yield f"{name} had {publishers} publishers; {told}"
    if report.resets:
        yield f"{report.resets} resets of the live run are repeated"
    if report.unknown_resets:
        told = "their requests are not in the log"
        yield f"{report.unknown_resets} resets of the live run are not repeated: {told}"
    if report.replaced:
        yield "An older file was replaced; --out NAME keeps both"
