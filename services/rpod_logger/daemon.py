"""The logger daemon: subscribes to the bus and passes all messages and commands to the recorder."""

import os
from functools import partial
from threading import Event

from rpod_logger.errors import CannotWriteError
from rpod_logger.memory import keep_freed_memory
from rpod_logger.recorder import Recorder
from rpod_logger.selection import Extras, patterns
from rpod_runtime import Node, Received
from rpod_runtime.notify import manager
from rpod_runtime.ros import trigger
from rpod_schemas.config.logger import LoggerConfig
from rpod_schemas.control import LogReply, LogRequest, StatusReply
from rpod_schemas.topics import DIAGNOSTICS

_TICK_S = 0.25
_ZENOH_THREADS = ("ZENOH_RUNTIME", "(rx:(worker_threads:1))")
"""Environment variable of Zenoh: one thread receives. By default two threads wake each other for every
message."""


def run(config: LoggerConfig, *, version: str, stop: Event) -> None:
    """Record until stopped, then drain and finish the log."""
    keep_freed_memory()
    os.environ.setdefault(*_ZENOH_THREADS)
    extras = Extras(config.bus.keys, config.record_extra)
    with (
        Node(config, version=version, stop=stop) as node,
        Recorder(config, version=version, health=node.health, account=node.account) as recorder,
    ):
        services = Services(node, recorder)
        recorder.know([node.status()])
        doing = _begin(recorder)
        node.health.watch(recorder.check)
        _subscribe(node, recorder, services, extras)
        _serve(node, recorder, services)
        node.ready(doing)
        while not stop.wait(_TICK_S):
            manager.alive()
            recorder.tell_losses()
            services.ask_new()
        services.ask()


def _begin(recorder: Recorder) -> str:
    """Start a log, return a text; if the disk refuses, messages count as lost until a ``start`` query."""
    try:
        return f"recording to {recorder.start().path}"
    except CannotWriteError:  # logged, and in the diagnostics
        return "not recording"


class Services:
    """Asks the services for their configuration, after their first heartbeat and before a log is closed.

    So the log also has the configuration of a service that dies before the log is closed.
    """

    def __init__(self, node: Node, recorder: Recorder) -> None:
        self._node, self._recorder = node, recorder
        self._hearts: set[bytes] = set()
        self._new = Event()

    def notice(self, received: Received) -> None:
        """Look at a message for the first heartbeat of a service."""
        if received.topic.name == DIAGNOSTICS.name and received.attachment.gid not in self._hearts:
            self._hearts.add(received.attachment.gid)
            self._new.set()

    def ask_new(self) -> None:
        """Ask the services if there is a new one."""
        if self._new.is_set():
            self._new.clear()
            self.ask()

    def ask(self) -> None:
        """Ask all services."""
        self._recorder.know(self._node.ask_all("status", StatusReply))


def _subscribe(node: Node, recorder: Recorder, services: Services, extras: Extras) -> None:
    def take(received: Received) -> None:
        recorder.put(received)
        services.notice(received)

    node.subscribe_all(patterns(), take)
    for index, expression in enumerate(extras.expressions):
        node.listen(expression, recorder.put, accept=partial(extras.owns, index))


def _serve(node: Node, recorder: Recorder, services: Services) -> None:
    def stop(_: LogRequest) -> LogReply:
        services.ask()
        return recorder.stop()

    def split(request: LogRequest) -> LogReply:
        services.ask()
        return recorder.split(request.name)

    call = trigger(LogRequest)
    node.serve("start", LogRequest, lambda request: recorder.start(request.name), ros=call)
    node.serve("stop", LogRequest, stop, ros=call)
    node.serve("split", LogRequest, split, ros=call)
