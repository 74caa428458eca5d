"""``rpod run``: the whole facility as processes on this machine, from start to report."""

import json
import logging
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Thread
from typing import Any, Self

from rpod import __version__
from rpod.errors import FailedServiceError, InterruptedRunError, NotReadyError
from rpod.play.draining import await_logged
from rpod.play.facility import Facility, Speed, configure
from rpod.play.fault_player import FaultPlayer
from rpod.play.progress import Progress
from rpod.play.start_watch import StartWatch
from rpod.play.supervisor import Supervisor
from rpod_runtime import Node, NoRouterError, QueryFailedError
from rpod_runtime.process.awake import AwakeClock
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.control import Accepted, StartRequest, StatusReply
from rpod_schemas.messages import NANOSECONDS

log = logging.getLogger(__name__)

_IDLE_S = 120.0
"""Longest time in which a service that starts does not work. A first start compiles kernels and builds the
target, which takes many minutes on a busy machine."""
_LONGEST_START_S = 3600.0
"""Longest time until all services are ready."""
_LEAD_S = 0.5
"""Time from the start query to the epoch."""
_ANSWER_S = 60.0
"""Longest time for the answer to a start query; a service is asked once, since it starts once."""
_STARTS = 20
"""Largest number of epochs that are tried, where the machine stands still for longer than the lead."""
_TURN_S = 5.0
"""Longest time that one look at all services takes, unless this process stands still."""
_POLL_S = 0.1
_LONG_START_S = 15.0
"""Time after which a start takes so long that kernels are likely being compiled, s; with compiled kernels it
takes 3 to 10 s."""
_COMPILING = "compiling takes minutes at a first start; a busy machine takes longer, too"
_VIEW, _LOGGER = "view", "logger"


@dataclass(frozen=True)
class RunFolder:
    """The folder of a run's files."""

    directory: Path
    log: Path
    """First file of the log."""

    @property
    def logs(self) -> list[Path]:
        """All existing files of the log in the order of time; the path of the first one if there is none."""
        return sorted(self.directory.glob("*.mcap")) or [self.log]

    @classmethod
    def make(cls, out: Path, scenario: Scenario) -> Self:
        """Create a new folder with the scenario, as it will be played, in it. Raises ``OSError``."""
        directory = _new_directory(out, scenario.name)
        document = json.loads(scenario.model_dump_json())
        (directory / "scenario.json").write_text(json.dumps(document, indent=2) + "\n", "utf-8")
        return cls(directory, directory / f"{scenario.name}.mcap")


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


def play(
    scenario: Scenario,
    folder: RunFolder,
    *,
    speed: Speed,
    progress: Progress,
    view: bool = False,
    pki: Path | None = None,
    meanwhile: Callable[[], object] = lambda: None,
) -> None:
    """Play a scenario to its end and close the log.

    Args:
        scenario: the scenario.
        folder: folder of the run.
        speed: its speed.
        progress: tells how far it is.
        view: whether there is a live view.
        pki: folder of certificates, which make the bus secure.
        meanwhile: called in a thread while the services stop, which leaves the processors free.

    Raises:
        ServiceDiedError: a service ended too early; the log is closed nevertheless.
        NotReadyError: a service did not start.
        InterruptedRunError: the operator ended the run; the log is closed nevertheless.
        SecurityError: a certificate is missing or cannot be used.
    """
    facility = configure(scenario, directory=folder.directory, speed=speed)
    if pki:
        from rpod.play.secure_run import secured  # noqa: PLC0415 - of an extra

        facility = secured(facility, pki.absolute(), rules=folder.directory / "config" / "rules.json")
    with _interruptible() as interrupted, Supervisor(folder.directory, progress.say) as services:
        services.start("router", facility.router)
        progress.note(f"bus: {facility.router.listen}, while the run lasts; files: {folder.directory}")
        if facility.proxy is not None:
            services.start("proxy", facility.proxy)
        _start_listeners_first(services, facility)
        if view:
            services.start(_VIEW, facility.view, optional=True)
        with _client(services, facility, interrupted) as node:
            if progress.is_shown:  # else the services have the time that reading these messages takes
                progress.watch(node, scenario, lockstep=speed == "max")
            _await_ready(node, services, facility, interrupted, progress)
            player = FaultPlayer(node, services, scenario)
            epoch_ns = _start(node, scenario, speed)
            lasts_s = 0.0 if speed == "max" else scenario.duration_s
            try:
                with player.playing(epoch_ns):
                    _await_end(node, services, interrupted, progress, lasts_s=lasts_s)
            except InterruptedRunError:
                _stop(node, services, facility)
                raise
            Thread(target=meanwhile, daemon=True).start()
            _stop(node, services, facility)
        services.stop("proxy")
        services.stop("router")


def _stop(node: Node, services: Supervisor, facility: Facility) -> None:
    """Stop the services, publishers before their receivers, each when its messages are in the log."""
    for verb in (*facility.services, _VIEW):
        if verb in facility.services and verb != _LOGGER:
            await_logged(node, verb, _LOGGER, check=services.check)
        services.stop(verb)


def _start_listeners_first(services: Supervisor, facility: Facility) -> None:
    """Start receivers before publishers; after an error, publishers are stopped first."""
    for verb, config in reversed(facility.services.items()):
        services.start(verb, config)


@contextmanager
def _client(services: Supervisor, facility: Facility, interrupted: Event) -> Iterator[Node]:
    """Open the supervisor's own client as soon as the router listens."""
    with ExitStack() as stack:
        while True:
            _check(services, interrupted)
            with suppress(NoRouterError):
                node = stack.enter_context(Node(facility.supervisor, version=__version__))
                break
        yield node


def _await_ready(
    node: Node, services: Supervisor, facility: Facility, interrupted: Event, progress: Progress
) -> None:
    waiting = {*facility.services, *(("proxy",) if facility.proxy else ())}
    clock, watch = AwakeClock(_TURN_S), StartWatch()
    while waiting:
        compiling = f"; {_COMPILING}" if clock.now_s() > _LONG_START_S else ""
        progress.say(f"waiting for {', '.join(sorted(waiting))}{compiling}")
        for verb in sorted(waiting):
            _check(services, interrupted)
            state = _state(node, verb)
            if state == "ready":
                waiting.discard(verb)
                continue
            if state == "failed":
                _check(services, interrupted)
                raise FailedServiceError(verb, services.log_of(verb))
            idle_s, now_s = watch.idle_s(services.pid_of(verb), clock.now_s()), clock.now_s()
            if idle_s > _IDLE_S or now_s > _LONGEST_START_S:
                raise NotReadyError(verb, now_s, services.log_of(verb))
        time.sleep(_POLL_S)  # a query returns at once while no service answers it


def _state(node: Node, verb: str) -> str:
    try:
        return node.ask(verb, "status", StatusReply, timeout_s=0.5).state
    except QueryFailedError:
        return "unknown"


def _start(node: Node, scenario: Scenario, speed: Speed) -> int:
    """Send epoch and duration to the emulator, then to the motion service; return the epoch, ns."""
    epoch_ns = scenario.epoch_ns
    for _ in range(_STARTS):
        begin_s = time.monotonic()
        if speed != "max":
            epoch_ns = time.time_ns() + round(_LEAD_S * NANOSECONDS)
        request = StartRequest(epoch_ns=epoch_ns, duration_s=scenario.duration_s)
        node.ask("emulator", "start", Accepted, request, timeout_s=_ANSWER_S)
        if speed == "max" or time.monotonic() - begin_s < _LEAD_S / 2.0:
            break  # else the epoch is near, or over: the emulator takes another one, motion would not
    else:
        text = "this machine stood still in each of %d starts: the first frames of the run may be missing"
        log.warning(text, _STARTS)
    request = StartRequest(epoch_ns=epoch_ns, duration_s=scenario.duration_s)
    node.ask("motion", "start", Accepted, request, timeout_s=_ANSWER_S)
    return epoch_ns


def _await_end(
    node: Node, services: Supervisor, interrupted: Event, progress: Progress, *, lasts_s: float
) -> None:
    """Wait until motion has played a scenario; it is asked only when ``lasts_s`` are over.

    Each answer has the whole configuration, and takes time that the services need.
    """
    begin_s = time.monotonic()
    while time.monotonic() - begin_s < lasts_s or _state(node, "motion") != "finished":
        _check(services, interrupted)
        progress.update()
        time.sleep(_POLL_S)  # not Event.wait: the signal handler that sets the event would wait for its lock


def _check(services: Supervisor, interrupted: Event) -> None:
    services.check()
    if interrupted.is_set():
        raise InterruptedRunError("interrupted")


@contextmanager
def _interruptible() -> Iterator[Event]:
    """Turn the first SIGINT or SIGTERM into an event; the second ends this process as usual."""
    interrupted = Event()
    before: dict[int, Any] = {}

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def handle(*_: object) -> None:
        interrupted.set()
        restore()

    for each in (signal.SIGINT, signal.SIGTERM):
        before[each] = signal.signal(each, handle)
    try:
        yield interrupted
    finally:
        restore()
