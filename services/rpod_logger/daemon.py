"""The logger daemon: subscribes to the bus and passes all messages and commands to the recorder."""

import os
import time
from contextlib import ExitStack, suppress
from functools import partial
from threading import Event

from rpod_logger.errors import BY_ITSELF, AlreadyRecordingError, CannotWriteError
from rpod_logger.memory import keep_freed_memory
from rpod_logger.publisher_ends import PublisherEnds
from rpod_logger.recorder import Recorder
from rpod_logger.selection import Extras, patterns
from rpod_runtime import Node, Received
from rpod_runtime.errors import RefusedError
from rpod_runtime.fault_book import FaultBook
from rpod_runtime.process.awake import AwakeClock
from rpod_runtime.process.lifecycle import Stop
from rpod_runtime.process.notify import manager
from rpod_runtime.requests.sole import Sole
from rpod_runtime.ros import trigger
from rpod_schemas.config.facility.logger import LoggerConfig
from rpod_schemas.control import Accepted, FaultRequest, LogReply, LogRequest
from rpod_schemas.faults.injected import InjectedFault
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.topics import DIAGNOSTICS, Topic

_TICK_S = 0.25
_RETRY_S = 5.0
"""Time between two attempts to begin the first log."""
_CLOSE_S = 3.0
"""Longest time, s, for which the close of a file waits for answers, and then for the messages that are
missing by these answers."""
_POLL_S = 0.02
_MOST_SERVICES = 1000
"""Largest number of services whose first heartbeat is remembered; one that was forgotten is asked again."""
_ZENOH_THREADS = ("ZENOH_RUNTIME", "(rx:(worker_threads:1))")
"""Environment variable of Zenoh: one thread receives. By default two threads wake each other for every
message."""


def run(config: LoggerConfig, *, version: str, stop: Event) -> None:
    """Record until stopped, then drain and finish the log."""
    keep_freed_memory()
    os.environ.setdefault(*_ZENOH_THREADS)
    extras = Extras(config.bus.keys, config.record_extra)
    sole = Sole(starts_beside=True)
    with Node(config, version=version, stop=stop, sole=sole) as node, ExitStack() as stack:
        ends = _follow_publishers(node)
        recorder = stack.enter_context(
            Recorder(config, version=version, health=node.health, account=node.account, endings=ends.take)
        )
        services = Services(node, recorder, ends)
        recorder.know([node.status()])
        readiness = _Readiness(node, recorder)
        readiness.begin()
        node.health.watch(recorder.check)
        _subscribe(node, recorder, services, extras)
        _serve(node, recorder, services)
        readiness.update()
        while not stop.wait(_TICK_S):
            manager.alive()
            recorder.log_losses()
            readiness.update()
            services.ask_new()
            ends.decide(time.monotonic())
        services.conclude()
        if isinstance(stop, Stop) and stop.orphaned:
            ends.add_reason("the run was ended by a kill: its supervisor ended without stopping the logger")


def _follow_publishers(node: Node) -> PublisherEnds:
    wanted = patterns()
    ends = PublisherEnds(
        lambda topic: any(pattern.covers(topic) for pattern in wanted), node.link, own=node.session_id
    )

    def gone(session: str, topic: Topic) -> None:
        ends.gone(session, topic, now_s=time.monotonic(), now_ns=time.time_ns())

    node.watch_publishers(gone, ends.came)
    return ends


class _Readiness:
    """Makes the service ready when it records, and reports to the manager when the log cannot be written.

    Where the first log cannot be written, the service is not ready, counts all messages as lost, and tries
    again until it can, or until a ``start`` query has opened a log.
    """

    def __init__(self, node: Node, recorder: Recorder) -> None:
        self._node, self._recorder = node, recorder
        self._failure, self._ready, self._next_s = "", False, 0.0

    def begin(self) -> None:
        """Try to open the first log."""
        self._next_s = time.monotonic() + _RETRY_S
        # ``update`` reports a failure; a log that is open already was opened by a query.
        with suppress(CannotWriteError, AlreadyRecordingError):
            self._recorder.start(again=BY_ITSELF)

    def update(self) -> None:
        """Try again if that is due, and report changes."""
        if not self._ready and not self._recorder.is_recording and time.monotonic() >= self._next_s:
            self.begin()
        if not self._ready and self._recorder.is_recording:
            self._ready, self._failure = True, ""
            self._node.ready(f"recording to {self._recorder.path}")
        if (failure := self._recorder.failure) != self._failure:
            self._failure = failure
            doing = failure or f"recording to {self._recorder.path}"
            manager.works(doing, at_work=not failure)
            if not self._ready:
                self._node.state = "failed"


class Services:
    """Asks the services for their configuration, after their first heartbeat and before a log is closed.

    So the log also has the configuration of a service that dies before the log is closed, and the logger
    knows how many messages were published until the close.
    """

    def __init__(self, node: Node, recorder: Recorder, ends: PublisherEnds) -> None:
        self._node, self._recorder, self._ends = node, recorder, ends
        self._known: dict[bytes, None] = {}
        """Gids of the services that have been asked, the oldest first."""
        self._new = Event()

    def notice(self, received: Received) -> None:
        """Look at a message: for the first heartbeat of a service, and for the last numbers of publishers."""
        self._ends.receive(received)
        if received.topic.name == DIAGNOSTICS.name and received.attachment.gid not in self._known:
            self._known[received.attachment.gid] = None
            if len(self._known) > _MOST_SERVICES:
                del self._known[next(iter(self._known))]
            self._new.set()

    def ask_new(self) -> None:
        """Ask the services if there is a new one."""
        if self._new.is_set():
            self._new.clear()
            self.ask()

    def ask(self, timeout_s: float = 1.0) -> None:
        """Ask all services."""
        statuses = self._node.ask_all(timeout_s=timeout_s)
        self._recorder.know(statuses)
        self._ends.confirm(statuses, now_s=time.monotonic())

    def conclude(self) -> None:
        """Ask all services before a file is closed, and wait until what they published has arrived."""
        begin_s = time.monotonic()
        self.ask(_CLOSE_S)
        self._ends.decide(time.monotonic())
        clock = AwakeClock(2.0 * _POLL_S)
        while self._ends.is_open(begin_s) and clock.now_s() < _CLOSE_S:
            time.sleep(_POLL_S)
            self._ends.decide(time.monotonic())
        self._ends.conclude(begin_s)


def _subscribe(node: Node, recorder: Recorder, services: Services, extras: Extras) -> None:
    def take(received: Received) -> None:
        recorder.put(received)
        services.notice(received)

    node.subscribe_all(patterns(), take)
    for index, expression in enumerate(extras.expressions):
        node.listen(expression, recorder.put, accept=partial(extras.owns, index))


def _serve(node: Node, recorder: Recorder, services: Services) -> None:
    def stop(_: LogRequest) -> LogReply:
        services.conclude()
        return recorder.stop()

    def split(request: LogRequest) -> LogReply:
        services.conclude()
        return recorder.split(request.name)

    call = trigger(LogRequest)
    node.serve("start", LogRequest, lambda request: recorder.start(request.name), ros=call)
    node.serve("stop", LogRequest, stop, ros=call)
    node.serve("split", LogRequest, split, ros=call)
    book = FaultBook(node)

    def fail(request: FaultRequest) -> Accepted:
        if request.kind.subject != "disk" or request.start_s:
            raise RefusedError("the logger injects disk_full alone, at once: leave start_s out")
        begin_ns = time.time_ns()
        end_ns = begin_ns + round(request.duration_s * NANOSECONDS)
        recorder.fill_disk(request.duration_s)
        book.publish([InjectedFault(request.fault, "", begin_ns, end_ns)])
        return Accepted()

    node.serve("fault", FaultRequest, fail)
