"""A process that searches for one sensor, so that tracking waits neither for the processor nor for a lock.

The first process of a sensor is a fork of the estimator: it has the target and the methods that the estimator
has created, and is ready at once. A fork has only the thread that forks, and a lock that another thread holds
stays locked for ever. Therefore the estimator forks before it opens the bus, and only if it has no other
threads than after its imports. These are harmless: those of ``lifecycle``, which wait in ``read``, and those
of OpenBLAS, which ends them itself before a fork. Otherwise (Open3D has threads once it has built a target),
and at each restart, the process is spawned: it creates its methods again, which takes seconds.

While a target is tracked, the process searches at a lower priority than the estimator, and a new process
starts at this priority. Without a track nothing is more urgent than the search. On Linux each thread has its
own priority, which can only be lowered. So a search of lower priority runs in a separate thread. The process
ends with the estimator, which waits at its start until the process is warm. A cancelled search ends at its
next step. If it has not ended after about the time of a restart, the process is replaced.
"""

import gc
import io
import logging
import os
import pickle
import signal
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from contextvars import copy_context
from dataclasses import dataclass
from multiprocessing import Pipe, get_context, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_pose.cancellation import CancelledError, cancelled_if
from rpod_pose.methods import kind_methods, ready_methods
from rpod_pose.navigation.first_pose.searches import Found, Search, find
from rpod_pose.ports import Methods
from rpod_schemas.config.sensor import SensorInput
from rpod_target import Target, load_target

log = logging.getLogger(__name__)

NICENESS = 10
"""Niceness of a search during a track, so that tracked frames do not wait for it on a loaded machine."""
RESTART_S = 3.0
"""Approximate time in which a process starts, imports and warms up, s."""
_STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that a terminal or a service manager sends to a whole group; only the estimator handles them."""
_READY, _CANCEL = b"ready", b"cancel"
_ENDED = "the process of the search has ended; it is started again after {:.0f} s"
_LONGEST_PAUSE_S = 60.0
"""Longest pause before a process that has ended is started again."""


@dataclass(frozen=True)
class Loaded:
    """Data that a fork inherits from the estimator."""

    target: Target
    methods: Methods | None
    """Methods of the sensor, warmed up; None while its setup is unknown."""
    setup: Any
    """Result of ``KindMethods.setup`` for these methods."""


class SearchProcess:
    """Searches for one sensor, one search at a time.

    Args:
        target: name or file of the target.
        sensor: configuration of the sensor.
        loaded: data that the first process inherits as a fork; None to spawn it.
        now_s: monotonic clock, s.
    """

    def __init__(
        self,
        target: str,
        sensor: SensorInput,
        loaded: Loaded | None = None,
        *,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._target, self._sensor, self._now_s = target, sensor, now_s
        self._pause_s = RESTART_S
        self._again_s: float | None = None
        if loaded is None:
            self._spawn(beside_tracking=False)
        else:
            self._fork(loaded)

    def _fork(self, loaded: Loaded) -> None:
        gc.freeze()  # a garbage collection writes to each object, which would copy the shared memory
        self._connection, theirs = Pipe()
        arguments = theirs, self._connection, self._sensor, loaded
        self._start(get_context("fork").Process(target=_serve_forked, args=arguments))
        theirs.close()

    def _spawn(self, *, beside_tracking: bool) -> None:
        self._connection, theirs = Pipe()
        arguments = theirs, self._target, self._sensor, beside_tracking
        resource_tracker.ensure_running()  # its start would unblock the signals again
        self._start(get_context("spawn").Process(target=serve, args=arguments))
        theirs.close()

    def _start(self, process: BaseProcess) -> None:
        self._process = process
        process.name, process.daemon = f"search-{self._sensor.name}", True
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _STOPS)  # the process inherits it
        try:
            process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self._is_ready = self._is_busy = False
        self._next: bytes | None = None
        self._unwanted_s: float | None = None

    @property
    def is_ready(self) -> bool:
        """Whether its methods are warmed up."""
        self._receive()
        return self._is_ready

    def begin(self, search: Search, setup: Any) -> None:
        """Search a frame as soon as possible; the previous search must have ended or be cancelled."""
        self._next = packed((search.sent, setup))
        self._receive()

    def result(self) -> Found | None:
        """Return the result of the newest search; None while it runs."""
        return self._receive()

    def cancel(self) -> None:
        """Cancel the newest search."""
        self._next = None
        if self._is_busy and self._unwanted_s is None:
            self._unwanted_s = self._now_s()
            with suppress(OSError):  # `_receive` reports that the process has ended
                self._connection.send_bytes(_CANCEL)
        self._receive()

    def end(self) -> None:
        """End the process at once."""
        self._process.kill()
        self._process.join()
        self._connection.close()

    def _receive(self) -> Found | None:
        """Take the results of the process, and give it the next search if it is free."""
        if self._again_s is not None and (self._now_s() < self._again_s or not self._restart()):
            return None
        found = None
        try:
            while self._connection.poll():
                said = self._connection.recv_bytes()
                self._is_ready = True
                if said == _READY:
                    continue
                self._is_busy, self._pause_s = False, RESTART_S
                if self._unwanted_s is None:
                    found = pickle.loads(said)  # noqa: S301 - of our own process
                self._unwanted_s = None
            if self._is_ready and not self._is_busy and self._next is not None:
                self._connection.send_bytes(self._next)
                self._next, self._is_busy = None, True
        except (EOFError, OSError):
            return self._give_up()
        if self._unwanted_s is not None and self._now_s() - self._unwanted_s > RESTART_S:
            self.end()
            self._restart()
        return found

    def _restart(self) -> bool:
        """Start the process again with the waiting search; return whether the system could start it."""
        waiting, self._again_s = self._next, None
        try:
            self._spawn(beside_tracking=True)
        except OSError as error:  # no memory, or too many processes or files
            log.error("%s: the search process cannot be started: %s", self._sensor.name, error)
            self._again_s = self._now_s() + self._pause_s
        self._next = waiting
        return self._again_s is None

    def _give_up(self) -> Found:
        """Return the result of a search whose process has ended; it is started again after a pause."""
        self._process.join(1.0)
        self.end()
        reason = _ENDED.format(self._pause_s)
        log.error("%s: exit code %s: %s", self._sensor.name, self._process.exitcode, reason)
        self._again_s = self._now_s() + self._pause_s
        self._pause_s = min(2.0 * self._pause_s, _LONGEST_PAUSE_S)
        return Found.nothing(reason)


def serve(
    connection: Connection, target_name: str, sensor: SensorInput, beside_tracking: bool = True
) -> None:
    """Run searches as long as the estimator runs.

    Args:
        connection: connection to the estimator.
        target_name: name or file of the target.
        sensor: configuration of the sensor.
        beside_tracking: whether the methods are created at the lower priority.
    """
    _ignore_stops()
    with _less_urgent() as executor:

        def load() -> Loaded:
            target = load_target(target_name)
            setup = kind_methods(sensor).setup(sensor, None)
            return Loaded(target, None if setup is None else ready_methods(sensor, target, setup), setup)

        loaded = executor.submit(load).result() if beside_tracking else load()
        _search_on(connection, sensor, loaded, executor)


def _serve_forked(connection: Connection, theirs: Connection, sensor: SensorInput, loaded: Loaded) -> None:
    signal.set_wakeup_fd(-1)  # a signal to this process must not wake the estimator
    _ignore_stops()
    theirs.close()  # with a copy of the estimator's connection, this process would not notice its closing
    with _less_urgent() as executor:
        _search_on(connection, sensor, loaded, executor)


def _less_urgent() -> ThreadPoolExecutor:
    """Return an executor whose one thread has a lower priority than the rest of the process."""
    return ThreadPoolExecutor(1, "less-urgent", initializer=os.nice, initargs=(NICENESS,))


def _ignore_stops() -> None:
    """Leave signals to the estimator, which ends this process."""
    for each in _STOPS:
        signal.signal(each, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _STOPS)


def _search_on(
    connection: Connection, sensor: SensorInput, loaded: Loaded, less_urgent: ThreadPoolExecutor
) -> None:
    target, methods, known = loaded.target, loaded.methods, pickle.dumps(loaded.setup)
    with suppress(EOFError, OSError):
        connection.send_bytes(_READY)
        while True:
            if (said := connection.recv_bytes()) == _CANCEL:
                continue  # the search had ended before
            search, setup = pickle.loads(said)  # noqa: S301 - of our own process
            if methods is None or pickle.dumps(setup) != known:
                methods, known = ready_methods(sensor, target, setup), pickle.dumps(setup)
            with cancelled_if(connection.poll):  # whatever is sent during a search cancels it
                if search.beside_track:
                    found = less_urgent.submit(copy_context().run, _found, search, methods).result()
                else:
                    found = _found(search, methods)
            connection.send_bytes(packed(found))


def native_threads() -> int | None:
    """Return the number of threads of this process, with those of libraries; None if it is unknown."""
    tasks = Path("/proc/self/task")
    return len(list(tasks.iterdir())) if tasks.is_dir() else None


def _found(search: Search, methods: Methods) -> Found:
    try:
        return find(search, methods)
    except CancelledError as error:
        return Found.nothing(str(error))


class _Pickler(pickle.Pickler):
    """Keeps arrays read-only: kernels are compiled separately for those."""

    def reducer_override(self, thing: object) -> Any:
        if type(thing) is np.ndarray and not thing.flags.writeable:
            return _read_only, (thing.copy(order="K"),)
        return NotImplemented


def packed(thing: object) -> bytes:
    """Return an object as bytes for ``pickle.loads``; read-only arrays stay so."""
    stream = io.BytesIO()
    _Pickler(stream, pickle.HIGHEST_PROTOCOL).dump(thing)
    return stream.getvalue()


def found_as_in_process(search: Search, methods: Methods) -> Found:
    """Return the result of a search as a process gives it, to the last bit.

    Poses are normalised once more on each way, which changes their last digits.
    """
    sent: Search = pickle.loads(packed(search.sent))  # noqa: S301 - our own
    result: Found = pickle.loads(packed(find(sent, methods)))  # noqa: S301 - our own
    return result


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    array.setflags(write=False)
    return array
