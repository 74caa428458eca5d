"""A bare echo over the router: what the bus itself costs, without any code of the facility.

A process answers each ping with a pong of the same number. A thread of this process sends pings of a given
size and rate, and notes when their pongs come. Run as a program, the module is the answering process.
"""

import subprocess
import sys
import time
from collections.abc import Callable
from threading import Event, Lock, Thread
from types import TracebackType
from typing import Self

import zenoh

from rpod_runtime.bus.session import open_client
from rpod_schemas.config.service import BusConfig

_PING, _PONG = "echo/ping", "echo/pong"
_NUMBER_BYTES = 8


class Echo:
    """Pings and their pongs; the answering process may be killed and started again."""

    def __init__(self, endpoint: str, *, rate_hz: float, size_bytes: int = _NUMBER_BYTES) -> None:
        self._endpoint, self._period_s = endpoint, 1.0 / rate_hz
        self._padding = bytes(max(0, size_bytes - _NUMBER_BYTES))
        self._sent_s: dict[int, float] = {}
        self._pongs: list[tuple[float, float]] = []
        self._lock, self._stop = Lock(), Event()
        self._process: subprocess.Popen[bytes] | None = None
        self._thread = Thread(target=self._send, name="echo", daemon=True)

    def __enter__(self) -> Self:
        self._session = open_client(BusConfig(connect=self._endpoint, wait=True))
        self._subscriber = self._session.declare_subscriber(_PONG, self._take)
        self.start()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()
        self.kill()
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]
        self._session.close()  # type: ignore[no-untyped-call]

    def start(self) -> None:
        """Start the answering process."""
        self._process = subprocess.Popen([sys.executable, "-P", __file__, self._endpoint])

    def kill(self) -> None:
        """Kill the answering process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def first_after(self, time_s: float) -> float | None:
        """Return when the first pong of a ping sent after a time came, monotonic s; None if none has come."""
        with self._lock:
            return next((arrived for sent, arrived in reversed_until(self._pongs, time_s)), None)

    def take(self) -> list[tuple[float, float]]:
        """Return and forget the pongs so far: times of ping and pong, monotonic s."""
        with self._lock:
            pongs, self._pongs = self._pongs, []
        return pongs

    def _send(self) -> None:
        publisher = self._session.declare_publisher(
            _PING, reliability=zenoh.Reliability.RELIABLE, congestion_control=zenoh.CongestionControl.DROP
        )
        number, due_s = 0, time.monotonic()
        while not self._stop.wait(max(0.0, due_s - time.monotonic())):
            number += 1
            due_s = max(due_s + self._period_s, time.monotonic() - self._period_s)
            with self._lock:
                self._sent_s[number] = time.monotonic()
                self._sent_s.pop(number - 10_000, None)
            publisher.put(number.to_bytes(_NUMBER_BYTES, "little") + self._padding)
        publisher.undeclare()  # type: ignore[no-untyped-call]

    def _take(self, sample: zenoh.Sample) -> None:
        now_s, number = time.monotonic(), int.from_bytes(sample.payload.to_bytes(), "little")
        with self._lock:
            sent_s = self._sent_s.pop(number, None)
            if sent_s is not None:
                self._pongs.append((sent_s, now_s))


def reversed_until(pongs: list[tuple[float, float]], time_s: float) -> list[tuple[float, float]]:
    """Return the pongs of pings that were sent after a time, the earliest first."""
    after = []
    for sent_s, arrived_s in reversed(pongs):
        if sent_s <= time_s:
            break
        after.append((sent_s, arrived_s))
    return after[::-1]


def respond(endpoint: str, wait: Callable[[], object]) -> None:
    """Answer pings until ``wait`` returns."""
    with open_client(BusConfig(connect=endpoint, wait=True)) as session:
        publisher = session.declare_publisher(
            _PONG, reliability=zenoh.Reliability.RELIABLE, congestion_control=zenoh.CongestionControl.DROP
        )
        subscriber = session.declare_subscriber(
            _PING, lambda sample: publisher.put(sample.payload.to_bytes()[:_NUMBER_BYTES])
        )
        wait()
        subscriber.undeclare()  # type: ignore[no-untyped-call]
        publisher.undeclare()  # type: ignore[no-untyped-call]


if __name__ == "__main__":
    respond(sys.argv[1], Event().wait)
