"""Kills a service, measures how long the facility takes to work again, and checks what the log says of it."""

import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from random import Random
from threading import Event, Lock
from typing import Any

import psutil
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from pydantic import TypeAdapter

from endurance.echo import Echo
from endurance.facility import KeptFacility, until
from rpod import __version__
from rpod_runtime import Node, QueryFailedError, Received
from rpod_schemas.config.service import BusConfig, ServiceConfig
from rpod_schemas.control import LogReply
from rpod_schemas.logs import COMPLETENESS, PUBLISHERS, Completeness, Numbers
from rpod_schemas.messages import read_odometry, read_status
from rpod_schemas.topics import STATUS, TRUTH
from rpod_schemas.types import Mode

_QUIET_S = 1.0, 2.0
"""Least and longest time before a kill, s, so that it falls anywhere between two syncs of the log."""
_SETTLE_S = 1.5
"""Time after which the logger has checked a publisher that is gone (1 s, ICD section 5)."""
_RECOVERY_S = 60.0
_TRUTH_HZ = 250.0
_NUMBERS = TypeAdapter(list[Numbers])


@dataclass(frozen=True)
class Kill:
    """What came of one kill."""

    service: str
    tracking_s: float
    """Time from the kill to the first accepted frame in TRACKING whose stamp is later than the kill; where
    motion was killed, no earlier than the first truth of its next process."""
    ready_s: float
    """Time from the kill until the service says that it is at work."""
    echo_s: float
    """The same for the bare echo: its own process killed, or, of the router, its link."""
    processor_s: float
    """Processor time of the new process and its own processes from the kill until it was at work, s: it does
    not depend on what else the machine does."""
    lost_s: float
    """Truth that no file holds, s, where the logger was killed; 0 of the others."""
    from_reserve: bool
    """Whether the new process is the one that waited in reserve."""
    wrong: tuple[str, ...]
    """Records of completeness that do not agree with what happened."""


class Watch:
    """The newest tracked frame, and the first truth of its present publisher, as others see them."""

    def __init__(self, node: Node) -> None:
        self._lock = Lock()
        self._stamp_ns, self._arrival_s, self.gid = 0, 0.0, b""
        self.truth_gid, self._truth_ns = b"", 0
        node.subscribe(STATUS, self._take)
        node.subscribe(TRUTH, self._take_truth)

    def _take_truth(self, received: Received) -> None:
        if received.attachment.gid != self.truth_gid:
            with self._lock:
                self._truth_ns = read_odometry(received.decode()).stamp_ns
                self.truth_gid = received.attachment.gid

    def truth_since_ns(self, not_gid: bytes) -> int | None:
        """Return the stamp of the first truth of another publisher; None before it has come."""
        with self._lock:
            return self._truth_ns if self.truth_gid != not_gid else None

    def _take(self, received: Received) -> None:
        status = read_status(received.decode())
        if status.mode is Mode.TRACKING and status.accepted:
            with self._lock:
                self._stamp_ns, self._arrival_s = status.stamp_ns, received.arrival_s
                self.gid = received.attachment.gid

    def tracked(self, after_ns: int, not_gid: bytes = b"") -> float | None:
        """Return when the newest tracked frame arrived, if its stamp is later; monotonic s."""
        with self._lock:
            fits = self._stamp_ns > after_ns and self.gid != not_gid
            return self._arrival_s if fits else None


@contextmanager
def desk(facility: KeptFacility, *, reserve: bool = False) -> Iterator["Desk"]:
    """Open the harness's own node and echo, and wait until the target is tracked.

    Args:
        facility: the facility.
        reserve: whether its services have processes in reserve, which must be warm before a kill.
    """
    bus = BusConfig(connect=facility.endpoint, wait=True)
    with (
        Node(ServiceConfig(instance="kills", bus=bus), version=__version__, stop=Event()) as node,
        Echo(facility.endpoint, rate_hz=100.0) as echo,
    ):
        watch = Watch(node)
        now_ns, now_s = time.time_ns(), time.monotonic()
        until(lambda: watch.tracked(now_ns), "the first track")
        until(lambda: echo.first_after(now_s), "the first echo")
        yield Desk(facility, node, echo, watch, reserve=reserve)


class Desk:
    """Kills services one after the other; the log is split after each kill, so that a file is about one."""

    def __init__(
        self, facility: KeptFacility, node: Node, echo: Echo, watch: Watch, *, reserve: bool
    ) -> None:
        self._reserve = reserve
        self._facility, self._node, self._echo, self._watch = facility, node, echo, watch
        self._checked = set[Path]()

    def settle(self) -> tuple[str, ...]:
        """Begin a new file, and return what is wrong of those before, in which nobody was killed."""
        self._split()
        return tuple(self._wrong(killed=""))

    def kill(self, name: str, rnd: Random) -> Kill:
        """Kill a service and wait until everything works again."""
        if self._reserve:
            until(lambda: self._facility.in_reserve(name), f"{name}: a process in reserve")
        self._node.stop.wait(rnd.uniform(*_QUIET_S))
        echo_s = None if name == "router" else self._kill_echo()
        told = self._facility.service(name)
        truth_gid = self._watch.truth_gid
        gid = self._watch.gid if name == "estimator" else b""
        spent_s = processor_s(told.get("reserve_pid"))
        killed_s, killed_ns = time.monotonic(), time.time_ns()
        os.kill(told["pid"], signal.SIGKILL)
        restarts = told["restarts"] + 1

        def tracked() -> float | None:
            """Motion publishes ahead of time: the killed one's truth gives frames after the kill."""
            begins_ns = self._watch.truth_since_ns(truth_gid) if name == "motion" else 0
            return None if begins_ns is None else self._watch.tracked(max(killed_ns, begins_ns), gid)

        def at_work() -> tuple[float, float, bool] | None:
            new = self._facility.ready(name, restarts)
            if not new:
                return None
            return time.monotonic(), processor_s(new["pid"]) - spent_s, new["pid"] == told.get("reserve_pid")

        tracked_s, (ready_s, spent_s, from_reserve) = both(tracked, at_work, f"{name}: a track, and at work")
        if echo_s is None:
            echo_s = until(lambda: self._echo.first_after(killed_s), "an echo", _RECOVERY_S) - killed_s
        self._node.stop.wait(_SETTLE_S)
        self._split()
        lost_s = self._lost_s() if name == "logger" else 0.0
        wrong = tuple(self._wrong(killed=name))
        return Kill(
            name, tracked_s - killed_s, ready_s - killed_s, echo_s, spent_s, lost_s, from_reserve, wrong
        )

    def _kill_echo(self) -> float:
        """Kill the echo's process and start it again as ``rpod up`` would; return how long that took, s."""
        killed_s = time.monotonic()
        self._echo.kill()
        self._node.stop.wait(0.1)
        self._echo.start()
        return until(lambda: self._echo.first_after(killed_s + 0.1), "an echo", _RECOVERY_S) - killed_s

    def _split(self) -> None:
        def asked() -> LogReply | None:
            try:
                return self._node.ask("logger", "split", LogReply, timeout_s=10.0)
            except QueryFailedError:
                return None  # it finds the router again a little later than this node

        until(asked, "a split of the log", _RECOVERY_S)

    def _files(self) -> list[Path]:
        return sorted(self._facility.logs.glob("*.mcap"), key=lambda path: (len(path.name), path.name))

    def _lost_s(self) -> float:
        """Return how much truth is missing between the file of the killed logger and the next one, s."""
        before, after = (truth_numbers(path) for path in self._files()[-3:-1])
        last = max(before, default=min(after, default=0))
        return (
            max(after, default=last) - last - len([each for each in set(after) if each > last])
        ) / _TRUTH_HZ

    def _wrong(self, *, killed: str) -> Iterator[str]:
        """Yield the closed files' records of completeness that do not agree with what happened."""
        for path in self._files()[:-1]:
            if path not in self._checked:
                self._checked.add(path)
                yield from false_claims(path, killed=killed)
                path.unlink() if killed != "logger" else None


def both(
    one: Callable[[], float | None], other: Callable[[], tuple[float, float, bool] | None], what: str
) -> tuple[float, tuple[float, float, bool]]:
    """Wait until two functions have returned something, in any order; return what each returned first."""
    found: dict[str, Any] = {}

    def seen() -> bool:
        for key, function in (("one", one), ("other", other)):
            if key not in found and (value := function()):
                found[key] = value
        return len(found) == 2

    until(seen, what, _RECOVERY_S)
    return found["one"], found["other"]


def processor_s(pid: int | None) -> float:
    """Return the processor time of a process and those that it started, s; 0 without a process."""
    if pid is None:
        return 0.0
    process = psutil.Process(pid)
    times = [each.cpu_times() for each in (process, *process.children(recursive=True))]
    return float(sum(each.user + each.system for each in times))


def truth_numbers(path: Path) -> Sequence[int]:
    """Return the sequence numbers of the truth in a file, which may have no end."""
    numbers: list[int] = []
    with path.open("rb") as stream:
        try:
            for _, _, message in NonSeekingReader(stream).iter_messages(
                f"/{TRUTH.name}", log_time_order=False
            ):
                numbers.append(message.sequence)
        except McapError:
            pass
    return numbers


def false_claims(path: Path, *, killed: str) -> Iterator[str]:
    """Yield what a file says wrongly of itself.

    Args:
        path: a file that is not written any more.
        killed: the service that was killed while it was written, empty if none was. A killed logger leaves a
            file without a record of completeness; the next one begins after the kill, and misses nothing.
    """
    try:
        with path.open("rb") as stream:
            reader = make_reader(stream)
            closed = reader.get_summary() is not None
            records = {item.name: item.metadata for item in reader.iter_metadata()} if closed else {}
    except McapError:
        records = {}
    said = Completeness.of_record(records.get(COMPLETENESS, {}))
    runs = [run for text in records.get(PUBLISHERS, {}).values() for run in _NUMBERS.validate_json(text)]
    gaps = [run for run in runs if run.last - run.first + 1 != run.messages]
    if said.complete and gaps:
        yield f"{path.name}: complete, but {gaps[0].key} has gaps"
    if said.complete and killed not in ("", "logger"):
        yield f"{path.name}: complete, but {killed} was killed"
    if not said.complete and not killed:
        yield f"{path.name}: not complete, but nobody was killed: {said.reasons}"
    if not said.complete and killed == "logger" and records:
        yield f"{path.name}: not complete, but it begins after the logger's kill: {said.reasons}"
    named = "the bus was lost" if killed == "router" else f"{killed} (session "
    if (
        not said.complete
        and killed not in ("", "logger")
        and not any(each.startswith(named) for each in said.reasons)
    ):
        yield f"{path.name}: does not name {killed}: {said.reasons}"
