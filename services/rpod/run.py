"""``rpod run``: the whole facility as processes on this machine, from start to report."""

import json
import logging
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from types import FrameType
from typing import Any

from rpod import __version__
from rpod.errors import InterruptedRunError, NotReadyError
from rpod.facility import Facility, Speed, configure
from rpod.progress import Progress
from rpod.supervisor import Supervisor
from rpod_runtime import Node, QueryFailedError
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.control import Accepted, StartRequest, StatusReply
from rpod_schemas.messages import NANOSECONDS

log = logging.getLogger(__name__)

_READY_TIMEOUT_S = 240.0
"""The first start on a machine compiles kernels and builds the target."""
_LEAD_S = 0.5
"""From telling the services to start to the epoch."""
_POLL_S = 0.1


@dataclass(frozen=True)
class Options:
    """How a scenario is played."""

    speed: Speed
    out: Path


@dataclass(frozen=True)
class Played:
    """What a run leaves behind."""

    directory: Path
    log: Path


def play(scenario: Scenario, options: Options, progress: Progress) -> Played:
    """Play a scenario to its end and close the log.

    Raises:
        ServiceDiedError: a service ended; the log is closed all the same.
        NotReadyError: a service did not start.
        InterruptedRunError: the operator ended the run; the log is closed all the same.
    """
    directory = _new_directory(options.out, scenario.name)
    facility = configure(scenario, directory=directory, speed=options.speed)
    with _interruptible() as interrupted, Supervisor(directory) as services:
        played = Played(directory, directory / f"{scenario.name}.mcap")
        services.start("router", facility.router)
        _start_listeners_first(services, facility)
        with Node(facility.supervisor, version=__version__) as node:
            progress.watch(node, scenario)
            _await_ready(node, services, facility, interrupted, progress)
            _start(node, scenario, options.speed)
            _await_end(node, services, interrupted, progress)
            for verb in facility.services:
                progress.say(f"stopping {verb}")
                services.stop(verb)
        services.stop("router")
    return played


def _new_directory(out: Path, name: str) -> Path:
    stem = f"{name}-{time.strftime('%Y%m%dT%H%M%S')}"
    for attempt in range(1, 100):
        directory = out / (stem if attempt == 1 else f"{stem}-{attempt}")
        try:
            directory.mkdir(parents=True)
        except FileExistsError:
            continue
        return directory.resolve()
    raise FileExistsError(out / stem)


def _start_listeners_first(services: Supervisor, facility: Facility) -> None:
    """Start those who listen before those who speak; what is left at an accident stops speakers first."""
    for verb, config in reversed(facility.services.items()):
        services.start(verb, config)


def _await_ready(
    node: Node, services: Supervisor, facility: Facility, interrupted: Event, progress: Progress
) -> None:
    waiting = set(facility.services)
    deadline_s = time.monotonic() + _READY_TIMEOUT_S
    while waiting:
        progress.say(f"waiting for {', '.join(sorted(waiting))}")
        for verb in sorted(waiting):
            _check(services, interrupted)
            if _state(node, verb) == "ready":
                waiting.discard(verb)
            elif time.monotonic() > deadline_s:
                raise NotReadyError(verb, _READY_TIMEOUT_S, services.log_of(verb))


def _state(node: Node, verb: str) -> str:
    try:
        return node.ask(verb, "status", StatusReply, timeout_s=0.5).state
    except QueryFailedError:
        return "unknown"


def _start(node: Node, scenario: Scenario, speed: Speed) -> None:
    """Tell emulator and motion the epoch, in this order."""
    lead_ns = round(_LEAD_S * NANOSECONDS)
    epoch_ns = scenario.epoch_ns if speed == "max" else time.time_ns() + lead_ns
    for verb in ("emulator", "motion"):
        node.ask(verb, "start", Accepted, StartRequest(epoch_ns=epoch_ns))


def _await_end(node: Node, services: Supervisor, interrupted: Event, progress: Progress) -> None:
    while _state(node, "motion") != "finished":
        _check(services, interrupted)
        progress.update()
        interrupted.wait(_POLL_S)


def _check(services: Supervisor, interrupted: Event) -> None:
    services.check()
    if interrupted.is_set():
        raise InterruptedRunError("interrupted")


@contextmanager
def _interruptible() -> Iterator[Event]:
    """Turn the first SIGINT or SIGTERM into an event; the second ends this process as usual."""
    interrupted = Event()
    before: dict[int, Any] = {}

    def handle(number: int, _: FrameType | None) -> None:
        interrupted.set()
        signal.signal(number, before[number])

    for each in (signal.SIGINT, signal.SIGTERM):
        before[each] = signal.signal(each, handle)
    try:
        yield interrupted
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def write_scenario(scenario: Scenario, directory: Path) -> None:
    """Keep the scenario as it was played beside its log."""
    document = json.loads(scenario.model_dump_json())
    (directory / "scenario.json").write_text(json.dumps(document, indent=2) + "\n", "utf-8")
