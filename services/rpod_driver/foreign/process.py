"""The host's side of a driver process: start, frames, time-outs, errors, end."""

import logging
import math
import os
import signal
import subprocess
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from queue import Empty, Queue
from threading import Event, Thread
from typing import Any, BinaryIO, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from rpod_driver.errors import ForeignDriverError, StoppedError
from rpod_driver.foreign import frame_pipe
from rpod_driver.foreign.config import ForeignEnvironment
from rpod_driver.stamps import StampMapper
from rpod_runtime.process.notify import manager
from rpod_runtime.process.processes import end_process
from rpod_schemas.config.driver import DriverConfig
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.sensors import sensor_kind, sensor_kinds
from rpod_schemas.types import SensorFrame, SensorInfo, SensorSync

log = logging.getLogger(__name__)

ModelT = TypeVar("ModelT", bound=BaseModel)

_TAIL_LINES = 10
_WAITING = 2
"""Number of messages that wait for the host; then the pipe is full, and the device's library drops."""
_POLL_S = 0.5
_TURN_S = 0.25
"""Longest time in which a stop is not noticed while the device is opened, s."""
_END_S = 2.0
"""Time in which a process ends after its input was closed, s."""
_INHERITED = ("PYTHONPATH", "PYTHONHOME", "PYTHONSTARTUP", "VIRTUAL_ENV", "CONDA_PREFIX")
"""Variables that describe this process's Python environment, which the driver process must not get."""


class ForeignDriver:
    """A driver whose frames come from a process with an environment of its own."""

    def __init__(
        self,
        config: DriverConfig,
        environment: ForeignEnvironment,
        script: Path,
        arguments: Sequence[str] = (),
    ) -> None:
        self._name, self._kind, self._environment = config.name, sensor_kind(config.kind), environment
        self._command = [str(environment.python), str(script), *arguments]
        self._shown = f"{environment.python} {script.name}"
        self._process: subprocess.Popen[bytes] | None = None
        self._partial = 0
        self._stop = Event()
        self._begin()

    def _begin(self) -> None:
        self._stamps = StampMapper(self._name, self._environment.stamps)
        self._messages: Queue[frame_pipe.Message | Exception | None] = Queue(_WAITING)
        self._tail: deque[str] = deque(maxlen=_TAIL_LINES)
        self._common: dict[str, Any] = {}
        self._due_s = -math.inf

    def take_stop(self, stop: Event) -> None:
        """Take the event that ends the wait for the device."""
        self._stop = stop

    def connect(self) -> SensorInfo | None:
        """Start the process and wait until its device is open.

        Raises:
            ForeignDriverError: it cannot be started, ends, or does not open its device in time.
            StoppedError: the driver was stopped meanwhile.
        """
        self._begin()
        environment = {name: value for name, value in os.environ.items() if name not in _INHERITED}
        environment["PYTHONPATH"] = str(Path(frame_pipe.__file__).parent)
        try:
            self._process = subprocess.Popen(
                self._command,
                env=environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C goes to the host alone, which ends the process
            )
        except OSError as error:
            raise ForeignDriverError(
                self._shown, f"cannot be started ({error.strerror}); correct device.python"
            ) from error
        out, err = cast(BinaryIO, self._process.stdout), cast(BinaryIO, self._process.stderr)
        self._threads = [
            Thread(target=self._read, args=(out, self._messages), daemon=True),
            Thread(target=self._log_lines, args=(err,), daemon=True),
        ]
        for thread in self._threads:
            thread.start()
        try:
            return self._info(self._first())
        except BaseException:
            self.close()
            raise

    def frames(self) -> Iterator[SensorFrame | None]:
        """Yield frames as they come. Raises ``ForeignDriverError``."""
        while True:
            message = self._next(_POLL_S)
            if message is not None and message.kind == "end":
                return
            if message is not None and message.kind == "idle":
                self._announce(message.fields.get("pause_s", 0.0))
            framed = message is not None and message.kind == "frame"
            yield self._frame(message) if framed and message else None

    def close(self) -> None:
        """End the process, by force if it does not end by itself, and all that it started."""
        process, self._process = self._process, None
        if process is None:
            return
        end_process(process, _END_S, ask=cast(BinaryIO, process.stdin).close)
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)  # a child of it would hold the pipe open
        reader, teller = self._threads
        while reader.is_alive():  # it may wait for a place in the queue
            while not self._messages.empty():
                self._messages.get_nowait()
            reader.join(0.01)
        teller.join(_END_S)
        cast(BinaryIO, process.stdout).close()
        cast(BinaryIO, process.stderr).close()

    def due_s(self) -> float:
        """Return when the next frame is due, s of the monotonic clock, as the process announced it."""
        return self._due_s

    def sync(self) -> SensorSync:
        """Return where the stamps come from."""
        return self._stamps.sync

    # --- messages ---

    def _first(self) -> frame_pipe.Message | None:
        """Return the first message, None if none came within ``start_s``."""
        end_s = time.monotonic() + self._environment.start_s
        while (left_s := end_s - time.monotonic()) > 0.0:
            if self._stop.is_set():
                raise StoppedError(self._name)
            manager.alive()
            if (message := self._next(min(left_s, _TURN_S))) is not None:
                return message
        return None

    def _next(self, timeout_s: float) -> frame_pipe.Message | None:
        """Return the next message, None if none came in time. Raises ``ForeignDriverError``."""
        try:
            message = self._messages.get(timeout=timeout_s)
        except Empty:
            return None
        if message is None:
            raise ForeignDriverError(self._shown, self._ending(), tuple(self._tail))
        if isinstance(message, Exception):
            raise ForeignDriverError(
                self._shown, f"sends what is no frame: {message}", tuple(self._tail)
            ) from message
        if message.kind == "error":
            raise ForeignDriverError(self._shown, f"says: {message.fields.get('text', 'an error')}")
        return message

    def _ending(self) -> str:
        """Return how the process ended, after its last lines have arrived."""
        try:
            how = f"ended with exit code {cast(subprocess.Popen[bytes], self._process).wait(_END_S)}"
        except subprocess.TimeoutExpired:
            how = "closed its pipe"
        self._threads[1].join(_END_S)
        return how

    def _info(self, message: frame_pipe.Message | None) -> SensorInfo | None:
        if message is None:
            waited_s = self._environment.start_s
            raise ForeignDriverError(
                self._shown,
                f"did not open its device within {waited_s:g} s (device.start_s)",
                tuple(self._tail),
            )
        if message.kind != "info":
            raise ForeignDriverError(
                self._shown, f"begins with {message.kind!r}, its first message has to be 'info'"
            )
        self._common = dict(message.fields.get("frame", {}))
        log.info("%s: %s", self._name, message.fields.get("text", "the device is open"))
        told = {**message.fields.get("info", {}), **message.arrays}
        return self._checked(self._kind.info_model, told) if told else None

    def _frame(self, message: frame_pipe.Message) -> SensorFrame:
        fields = {**self._common, **message.fields}
        device_ns, partial = fields.pop("stamp_ns", None), fields.pop("partial", "")
        if partial:
            self._log_partial(str(partial))
        stamp_ns = self._stamps.utc_ns(device_ns, after_ns=_after_ns(message.arrays.get("time_s")))
        return self._checked(
            self._kind.frame, {"frame_id": "", **fields, **message.arrays, "stamp_ns": stamp_ns}
        )

    def _checked(self, model: type[ModelT] | None, values: dict[str, Any]) -> ModelT:
        if model is None:
            able = ", ".join(kind.name for kind in sensor_kinds() if kind.frame is not None)
            reason = f"cannot bring what a {self._kind.title} sends: its kind names no model of it"
            raise ForeignDriverError(self._shown, f"{reason}; frames may be of {able}")
        try:
            return model.model_validate(values)
        except ValidationError as error:
            first = error.errors(include_url=False, include_input=False)[0]
            field = ".".join(map(str, first["loc"]))
            raise ForeignDriverError(
                self._shown, f"sends no {model.__name__}: {field}: {first['msg']}"
            ) from error

    def _announce(self, pause_s: object) -> None:
        if not isinstance(pause_s, int | float) or not 0.0 <= pause_s < math.inf:
            raise ForeignDriverError(
                self._shown, f"sends idle with pause_s {pause_s!r}; send a number of seconds from 0"
            )
        self._due_s = time.monotonic() + pause_s

    def _log_partial(self, what: str) -> None:
        self._partial += 1
        if self._partial == 10 ** (len(str(self._partial)) - 1):
            log.warning("%s: %s (%d such frames so far)", self._name, what, self._partial)

    # --- threads ---

    @staticmethod
    def _read(stream: BinaryIO, messages: "Queue[frame_pipe.Message | Exception | None]") -> None:
        while True:
            try:
                message = frame_pipe.receive(stream)
            except (ValueError, OSError) as error:
                messages.put(error)
                return
            messages.put(message)
            if message is None:
                return

    def _log_lines(self, stream: BinaryIO) -> None:
        for line in stream:
            text = line.decode(errors="replace").rstrip()
            self._tail.append(text)
            log.info("%s: process: %s", self._name, text)


def _after_ns(time_s: NDArray[Any] | None) -> int:
    """Return the time from a scan's stamp to its last point, ns; 0 for frames without times of points."""
    timed = np.empty(0) if time_s is None else time_s[np.isfinite(time_s)]
    return round(float(timed.max()) * NANOSECONDS) if timed.size else 0
