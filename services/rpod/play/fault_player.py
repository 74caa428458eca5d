"""Plays the faults of a run's links, processes and disk at their times, and takes requests for them.

A process is killed, stopped and slowed by signals. A killed service is started again when its fault ends. The
emulator is told the run's epoch again, and an estimator gets another identity on the bus, since receivers
know the messages of a session by their numbers. The proxy makes the faults of links, the logger that of the
disk, on request.
"""

import logging
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Event, Lock, Thread

from rpod.play.supervisor import Supervisor
from rpod_runtime import Node, QueryFailedError
from rpod_runtime.errors import RefusedError
from rpod_runtime.fault_book import FaultBook
from rpod_runtime.process.awake import AwakeClock
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.control import Accepted, FaultRequest, LogReply, LogRequest, StartRequest, StatusReply
from rpod_schemas.faults import AskedFault
from rpod_schemas.faults.injected import InjectedFault
from rpod_schemas.messages import NANOSECONDS

log = logging.getLogger(__name__)

_TURN_S = 0.01
_SLOW_PERIOD_S = 0.1
"""Period in which a slow process is suspended for its share of the time."""
_ALWAYS_NS = 2**62
_RECORD_S = 30.0
"""Longest time until the logger records again after its disk was full."""
_TURN_MOST_S = 6.0
"""Longest time that one request takes, s, unless this process stands still."""
_BACK_S = 60.0
"""Longest time that a service may take to be at work again."""
_MOST_FAULTS = 500
_RESTARTED = ("router", "emulator", "estimator", "logger")


@dataclass
class _Playing:
    """A fault with its times."""

    asked: AskedFault
    begin_ns: int
    end_ns: int
    begun: bool = False
    stands: bool = False
    """Whether the process is suspended now."""

    @property
    def injected(self) -> InjectedFault:
        end_ns = None if self.end_ns == _ALWAYS_NS else self.end_ns
        return InjectedFault(self.asked.fault, self.asked.where, self.begin_ns, end_ns, self.asked.amount)


class FaultPlayer:
    """Plays faults in a thread of its own."""

    def __init__(self, node: Node, services: Supervisor, scenario: Scenario) -> None:
        self._node, self._services, self._scenario = node, services, scenario
        self._book = FaultBook(node)
        self._lock = Lock()
        self._faults: list[_Playing] = []
        self._epoch_ns = 0
        self._asked, self._over = Event(), Event()
        node.serve("fault", FaultRequest, self._request)

    @contextmanager
    def playing(self, epoch_ns: int) -> Iterator[None]:
        """Play the scenario's faults, whose times count from an epoch, ns; end those that outlast the run."""
        self._epoch_ns = epoch_ns
        planned = [fault for fault in self._scenario.faults if not fault.kind.of_sensor]
        for fault in planned:
            begin_ns = epoch_ns + round(fault.start_s * NANOSECONDS)
            lasts_s = fault.duration_s
            end_ns = _ALWAYS_NS if lasts_s is None else begin_ns + round(lasts_s * NANOSECONDS)
            self._add(fault, begin_ns, end_ns)
        thread = Thread(target=self._play, name="faults", daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._over.set()
            self._asked.set()
            thread.join()

    def _request(self, request: FaultRequest) -> Accepted:
        kind = request.kind.subject
        if kind != "process":
            raise RefusedError(
                f"{request.fault} is no fault of a process; ask rpod/emulator/fault, rpod/proxy/fault or "
                "rpod/logger/fault"
            )
        begin_ns = time.time_ns() + round(request.start_s * NANOSECONDS)
        self._add(request, begin_ns, begin_ns + round(request.duration_s * NANOSECONDS))
        return Accepted()

    def _add(self, asked: AskedFault, begin_ns: int, end_ns: int) -> None:
        if asked.fault == "kill" and asked.service not in _RESTARTED:
            raise RefusedError(
                f"{asked.service} cannot be killed: only {', '.join(_RESTARTED)} are started again"
            )
        with self._lock:
            if len(self._faults) >= _MOST_FAULTS:
                raise RefusedError(f"{_MOST_FAULTS} faults are planned or active already; wait for their end")
            self._faults.append(_Playing(asked, begin_ns, end_ns))
        self._asked.set()

    def _play(self) -> None:
        self._asked.wait()  # without a fault there is nothing to do
        while not self._over.wait(_TURN_S):
            self._turn(time.time_ns())
        self._turn(_ALWAYS_NS)

    def _turn(self, now_ns: int) -> None:
        with self._lock:
            faults = list(self._faults)
        for fault in faults:
            try:
                if not fault.begun and fault.begin_ns <= now_ns < _ALWAYS_NS:
                    fault.begun = True
                    self._begin(fault)
                if fault.begun and fault.asked.fault == "slow":
                    self._pace(fault, now_ns)
                if fault.end_ns <= now_ns:
                    with self._lock:
                        self._faults.remove(fault)
                    if fault.begun:
                        self._end(fault)
            except QueryFailedError as error:
                log.error("fault %s: %s", fault.asked.fault, error)

    def _begin(self, fault: _Playing) -> None:
        asked, service = fault.asked, fault.asked.service or ""
        match asked.fault:
            case "kill":
                self._services.kill(service)
            case "stop":
                self._services.signal(service, signal.SIGSTOP)
            case "slow":
                pass
            case _:
                self._ask_injector(fault)
                return  # proxy and logger publish it themselves
        self._book.publish([fault.injected])

    def _ask_injector(self, fault: _Playing) -> None:
        asked = fault.asked
        lasts_s = min((fault.end_ns - fault.begin_ns) / NANOSECONDS, 86_400.0)
        request = FaultRequest(fault=asked.fault, service=asked.service, size=asked.size, duration_s=lasts_s)
        server = "logger" if asked.kind.subject == "disk" else "proxy"
        self._node.ask(server, "fault", Accepted, request)

    def _pace(self, fault: _Playing, now_ns: int) -> None:
        """Suspend a slow process for its share of each period."""
        phase = ((now_ns - fault.begin_ns) / NANOSECONDS / _SLOW_PERIOD_S) % 1.0
        stands = phase < (fault.asked.amount or 0.0) and now_ns < fault.end_ns
        if stands != fault.stands:
            fault.stands = stands
            self._services.signal(fault.asked.service or "", signal.SIGSTOP if stands else signal.SIGCONT)

    def _end(self, fault: _Playing) -> None:
        service = fault.asked.service or ""
        match fault.asked.fault:
            case "kill":
                if not self._over.is_set():
                    self._restart(service)
            case "stop" | "slow":
                self._services.signal(service, signal.SIGCONT)
            case "disk_full":
                if not self._over.is_set():
                    self._record_again()
            case _:
                pass

    def _record_again(self) -> None:
        """Start a new log; try again until the logger's own fault has ended, a moment later."""
        clock = AwakeClock(_TURN_MOST_S)
        while True:
            try:
                self._node.ask("logger", "start", LogReply, LogRequest())
                return
            except QueryFailedError:
                if clock.now_s() > _RECORD_S:
                    raise
                time.sleep(10 * _TURN_S)

    def _restart(self, service: str) -> None:
        self._services.restart(service)
        if service == "emulator":
            Thread(target=self._start_emulator, name="restart", daemon=True).start()

    def _start_emulator(self) -> None:
        """Start the run in an emulator that was started again, with the run's own epoch."""
        request = StartRequest(epoch_ns=self._epoch_ns, duration_s=self._scenario.duration_s)
        clock = AwakeClock(_TURN_MOST_S)
        while not self._over.wait(10 * _TURN_S):
            try:
                if self._node.ask("emulator", "status", StatusReply, timeout_s=0.5).state == "ready":
                    self._node.ask("emulator", "start", Accepted, request)
                    return
            except QueryFailedError as error:
                if clock.now_s() > _BACK_S:
                    log.error("the emulator that was started again makes no frames: %s", error)
                    return
