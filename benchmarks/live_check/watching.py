"""What came of a sensor on the bus, and what the check would have said of it after each time."""

import gzip
import pickle
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Event
from typing import Any

from live_check.players import SENSORS, Case
from rpod import __version__
from rpod_driver.check import CheckResult, Level, Observer, Options
from rpod_driver.check import judge as check
from rpod_driver.check.surface import Surface
from rpod_runtime import Inbox, Node, Received
from rpod_runtime.errors import QueryFailedError
from rpod_schemas.config.service import BusConfig, ServiceConfig
from rpod_schemas.control import StatusReply
from rpod_schemas.faults import BY_NAME
from rpod_schemas.messages import NANOSECONDS
from rpod_target import load_target

AFTER_S = (2, 6, 20)
"""Times after which the check is asked, s; those beyond the recording tell the same as its end."""


@dataclass
class Recorded:
    """All that a check of one sensor gets."""

    options: Options
    messages: list[Received] = field(default_factory=list)
    tokens: list[tuple[str, str, str]] = field(default_factory=list)
    began_ns: int = 0
    load_average: float = 0.0


def await_emulator(node: Node, cases: Sequence[Case], timeout_s: float = 90.0) -> None:
    """Wait until the emulator has made some frames of each sensor; its first start compiles kernels."""
    deadline_s = time.monotonic() + timeout_s
    while time.monotonic() < deadline_s:
        try:
            counters = node.ask("emulator", "status", StatusReply, timeout_s=5.0).counters
        except QueryFailedError:
            counters = {}
        sends = [case.name for case in cases if case.fault != "silence"]
        made = [counters.get(f"frames/{name}", 0) for name in sends]
        if min(made, default=3) >= 3:
            return
        Event().wait(0.1)
    raise TimeoutError(f"the emulator made no frames within {timeout_s:g} s")


def record(
    endpoint: str, sensors: Mapping[str, tuple[str, Options]], duration_s: float
) -> dict[str, Recorded]:
    """Receive what ``rpod driver check`` would of some sensors, by name, each with its kind and options."""
    told: dict[str, Recorded] = {}
    with ExitStack() as stack:
        inboxes = {}
        for name, (kind, options) in sensors.items():
            config = ServiceConfig(instance=f"check-{name}", bus=BusConfig(connect=endpoint))
            node = stack.enter_context(Node(config, version=__version__, stop=Event()))
            observer, inbox = Observer(kind, name, options), Inbox(capacity=50_000)
            told[name] = Recorded(options, began_ns=time.time_ns())
            for topic in (*observer.latched, *observer.streams, *observer.others):
                node.subscribe(topic, inbox.put)
            node.watch_publisher_qos(told[name].tokens.append)
            inboxes[name] = inbox
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s:
            Event().wait(0.05)
            for name, inbox in inboxes.items():
                told[name].messages += inbox.wait(0.0)
    return told


def save(folder: Path, case: Case, told: Recorded, load_average: float) -> None:
    """Keep what came, to judge it."""
    messages = [replace(each, payload=bytes(each.payload)) for each in told.messages]  # type: ignore[arg-type]
    with gzip.open(folder / f"{case.name}_{case.seed}.pickle.gz", "wb", compresslevel=1) as file:
        pickle.dump((tuple(case), load_average, told.began_ns, told.tokens, messages), file)


def load(path: Path, options: Callable[[Case], Options]) -> tuple[Case, Recorded]:
    """Return what came, as it was saved."""
    with gzip.open(path, "rb") as file:
        case, load_average, began_ns, tokens, messages = pickle.load(file)  # noqa: S301 - our own
    kept = [replace(each, payload=memoryview(each.payload)) for each in messages]
    case = Case(*case)
    return case, Recorded(options(case), kept, tokens, began_ns, load_average)


def options_of(case: Case, target: str | None = "mockup") -> Options:
    """Return what a user tells the check of an emulated sensor."""
    surface = Surface.of(load_target(target)) if target else None
    return Options(rate_hz=SENSORS[case.kind]["rate_hz"], surface=surface)


def judged(case: Case, told: Recorded) -> dict[str, Any]:
    """Return after which time each fault was named first, and from which time on; and the last results."""
    first_s: dict[str, float] = {}
    steady_s: dict[str, float] = {}
    results: list[CheckResult] = []
    for after_s in AFTER_S:
        until_ns = told.began_ns + after_s * NANOSECONDS
        observer = Observer(case.kind, case.name, told.options)
        for received in told.messages:
            if received.arrival_ns <= until_ns:
                observer.take(received)
        observer.take_tokens(told.tokens)
        results = check(observer.end(until_ns))
        named = [fault for each in results for fault in each.faults]
        for fault in named:
            first_s.setdefault(fault, after_s)
        steady_s = {fault: steady_s.get(fault, after_s) for fault in named}
    texts = {str(level): {each.line: each.text for each in results if each.level is level} for level in Level}
    line = BY_NAME[case.fault].line if case.fault else ""
    about = case._asdict() | {"line": line, "load": round(told.load_average, 1)}
    return about | {"first_s": first_s, "steady_s": steady_s} | texts
