"""A router, and a publisher that counts what it publishes, as processes that a test may kill."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread

from rpod_runtime import Node
from rpod_runtime.bus.session import free_endpoint, open_router
from rpod_runtime.process.lifecycle import run
from rpod_schemas.config.service import BusConfig, RouterConfig, ServiceConfig
from rpod_schemas.messages import write_clock
from rpod_schemas.topics import CLOCK

_PERIOD_S = 0.004


class BusProcess:
    """A process that says a line when it is ready, and more lines later."""

    def __init__(self, *arguments: str) -> None:
        self._process = subprocess.Popen([sys.executable, __file__, *arguments], stdout=subprocess.PIPE)
        assert self._process.stdout
        self._out = self._process.stdout
        assert self._out.readline() == b"0\n"
        self._last = 0
        self._thread = Thread(target=self._count, daemon=True)
        self._thread.start()

    def _count(self) -> None:
        for line in self._out:
            self._last = int(line)

    @property
    def published(self) -> int:
        """Number of messages that were handed to the bus, as far as the process has said."""
        return self._last

    def send(self, number: signal.Signals) -> None:
        self._process.send_signal(number)

    def suspend(self) -> None:
        """Stop the process, and wait until all its threads stand: one may answer until it is stopped."""
        self._process.send_signal(signal.SIGSTOP)
        threads = Path(f"/proc/{self._process.pid}/task")
        while any(") T " not in (thread / "stat").read_text() for thread in threads.iterdir()):
            time.sleep(0.001)

    def end(self, number: signal.Signals) -> int:
        """Send a signal, wait, and return how many messages were published at last."""
        self._process.send_signal(number)
        self._process.wait(60.0)
        self._thread.join(60.0)
        return self._last

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        self._thread.join()
        self._out.close()


@contextmanager
def router_process(endpoint: str = "") -> Iterator[tuple[BusProcess, str]]:
    """Run a router; yields it and its endpoint."""
    endpoint = endpoint or free_endpoint()
    process = BusProcess("router", endpoint)
    try:
        yield process, endpoint
    finally:
        process.close()


@contextmanager
def publisher_process(bus: BusConfig) -> Iterator[BusProcess]:
    """Run a publisher of ``clock`` at 250 Hz that ends in order at SIGTERM."""
    process = BusProcess("publisher", bus.model_dump_json())
    try:
        yield process
    finally:
        process.close()


def _say(number: int) -> None:
    os.write(1, b"%d\n" % number)


def _publish(bus: str, stop: Event) -> None:
    config = ServiceConfig(instance="publisher", bus=BusConfig.model_validate_json(bus))
    with Node(config, version="test", stop=stop) as node:
        clock = node.publisher(CLOCK)
        node.ready("publishing")
        _say(0)
        number = 0
        while not stop.wait(_PERIOD_S):
            number += 1
            clock.publish(write_clock(number))
            _say(number)


def _route(endpoint: str, stop: Event) -> None:
    with open_router(RouterConfig(listen=endpoint)):
        _say(0)
        stop.wait()


if __name__ == "__main__":
    body = {"router": _route, "publisher": _publish}[sys.argv[1]]
    sys.exit(run(sys.argv[1], lambda stop: body(sys.argv[2], stop)))
