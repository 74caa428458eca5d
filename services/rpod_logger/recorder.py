"""The writer's thread: takes messages from the backlog and writes them to one log after the other."""

import errno
import logging
import time
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from threading import Thread
from types import TracebackType
from typing import Self

from pydantic import BaseModel

from rpod_logger.backlog import Backlog, Command
from rpod_logger.errors import (
    BY_QUERY,
    AlreadyRecordingError,
    CannotWriteError,
    LoggerError,
    NotRecordingError,
)
from rpod_logger.latched import LatchedMessages
from rpod_logger.publisher_ends import Endings
from rpod_logger.recording import Recording, Totals
from rpod_logger.writer import WriterSettings, create_log, signing_key
from rpod_runtime import Received
from rpod_runtime.delivery.accounting import SequenceAccount
from rpod_runtime.health import HealthBook
from rpod_runtime.process.reloading import reloader
from rpod_schemas.config.facility.logger import LoggerConfig
from rpod_schemas.control import LogReply, StatusReply
from rpod_schemas.errors import Reason
from rpod_schemas.reload import ReloadReply
from rpod_schemas.types import Health
from rpod_security.errors import SecurityError

log = logging.getLogger(__name__)

_COMMAND_TIMEOUT_S = 30.0
_IDLE_S = 0.05
"""Time for which the writer waits while few messages are queued."""
_LOSSES_PERIOD_S = 5.0
_MOST_SERVICES = 1000
"""Largest number of services whose configuration is in a log."""
_CLOCK_JUMP_S = 0.5
"""Smallest change between the two clocks that counts as a jump. A delay of the process between the readings
of both clocks, or a slow correction of the clock, changes them by less."""


class Recorder:
    """Records the messages put into it. ``with`` runs its thread; at the end it writes what is queued."""

    def __init__(
        self,
        config: LoggerConfig,
        *,
        version: str,
        health: HealthBook,
        account: SequenceAccount,
        endings: Callable[[int], Endings] = lambda _: Endings(),
    ) -> None:
        """Prepare; ``endings`` returns, once, what ended while a file opened at a stamp was recorded."""
        self._config, self._version, self._endings = config, version, endings
        self._health, self._account = health, account
        self._backlog = Backlog(config.queue_bytes)
        self._recording: Recording | None = None
        self._stem = config.name or f"rpod-{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
        self._failure: CannotWriteError | None = None
        self._latched = LatchedMessages()
        self._written: Counter[str] = Counter()
        """Number of messages of the current batch, by topic."""
        self._services: dict[str, StatusReply] = {}
        self._lost_reported = 0
        self._next_report_s = 0.0
        self._split_asked = False
        self._clock_offset_s: float | None = None
        self._full_until_s = float("-inf")
        self._thread = Thread(target=self._run, name="writer")

    def _reconfigure(self, config: BaseModel, _: ReloadReply) -> None:
        """Take the fields that may change: intervals and sizes at once, the folder with the next file."""
        if isinstance(config, LoggerConfig):
            self._config = config

    def __enter__(self) -> Self:
        reloader.on_change(self._reconfigure)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._backlog.close(self._finish)
        self._thread.join()

    # --- from any thread ---

    def put(self, received: Received) -> None:
        """Record a message without waiting; if there is no room it is lost, counted and reported."""
        if not self._backlog.put(received):
            self._health.count(f"lost/{received.topic.name}")

    def know(self, services: Iterable[StatusReply]) -> None:
        """Store the status and configuration of services in this log and the next ones."""
        statuses = list(services)
        self._backlog.command(lambda _: self._know(statuses))

    def start(self, name: str | None = None, *, again: str = BY_QUERY) -> LogReply:
        """Open a log, under the last name if none is given. Raises ``LoggerError``.

        ``again`` names, for the operator, what begins the next recording if this one cannot begin.
        """
        return self._run_in_writer(lambda received: self._open(name, received, again=again))

    def stop(self) -> LogReply:
        """Close the log. Raises ``LoggerError`` if none is open."""
        return self._run_in_writer(self._close)

    def split(self, name: str | None = None) -> LogReply:
        """Close the log and go on in a new one; each message is in exactly one. Raises ``LoggerError``."""
        return self._run_in_writer(lambda received: self._renew(name, received))

    def fill_disk(self, duration_s: float) -> None:
        """Treat the disk as full for a time, s: an injected fault."""
        self._full_until_s = time.monotonic() + duration_s

    @property
    def is_recording(self) -> bool:
        """Whether a log is open."""
        return self._recording is not None

    @property
    def path(self) -> str:
        """Path of the open log; empty if there is none."""
        recording = self._recording
        return "" if recording is None else str(recording.file.path.resolve())

    @property
    def failure(self) -> str:
        """Why nothing is recorded although it should be; empty if nothing failed."""
        return str(self._failure) if self._failure and self._recording is None else ""

    def check(self) -> tuple[Health, str]:
        """Return the health: ERROR until the process ends if a message was ever lost or missed."""
        self._health.put("queue/bytes", self._backlog.bytes)
        self._health.put("queue/high_water_bytes", self._backlog.high_water_bytes)
        self._health.put("queue/capacity_bytes", self._backlog.capacity_bytes)
        recording, doing = self._recording, "not recording"
        if recording is not None:
            doing = f"recording {recording.file.messages} messages to {recording.file.path.name}"
        elif self._failure:
            doing = str(self._failure)
        lost, missed = self._lost(), self._totals(Counter()).missed.total()
        if lost or missed:
            return Health.ERROR, f"{doing}; {lost} lost here, {missed} missed on the bus"
        return (Health.ERROR if self._failure else Health.OK), doing

    def log_losses(self) -> None:
        """Write a log line with the number of messages lost since the line before, at most every 5 s."""
        lost = self._lost()
        if lost > self._lost_reported and time.monotonic() >= self._next_report_s:
            full = (
                f"the queue of {self._config.queue_bytes >> 20} MiB is full, because the disk is too slow; "
                "record to a faster disk or raise queue_bytes"
            )
            log.error("lost %d messages: %s", lost - self._lost_reported, self._failure or full)
            self._lost_reported, self._next_report_s = lost, time.monotonic() + _LOSSES_PERIOD_S

    def _lost(self) -> int:
        counters = self._health.counters()
        return sum(count for name, count in counters.items() if name.startswith("lost/"))

    def _run_in_writer(self, action: Callable[[Counter[str]], LogReply]) -> LogReply:
        outcome: Future[LogReply] = Future()

        def run(received: Counter[str]) -> None:
            try:
                outcome.set_result(action(received))
            except Exception as error:  # noqa: BLE001 - the caller gets it
                outcome.set_exception(error)

        if not self._backlog.command(run):
            raise NotRecordingError
        return outcome.result(_COMMAND_TIMEOUT_S)

    # --- in the writer's thread ---

    def _run(self) -> None:
        next_sync_s = time.monotonic() + self._config.sync_interval_s
        while not self._backlog.finished:
            for item in self._backlog.take(_IDLE_S):
                if isinstance(item, Command):
                    item.action(item.received)
                else:
                    self._write(item)
            self._count_written()
            if time.monotonic() >= next_sync_s:
                self._sync()
                next_sync_s = time.monotonic() + self._config.sync_interval_s

    def _write(self, received: Received) -> None:
        if received.topic.latched:
            self._keep(received)
        self._watch_clock(received)
        if self._attempt(lambda recording: recording.write(received)):
            self._written[received.topic.name] += 1
            self._close_or_split()
        elif self._failure:
            self._health.count(f"lost/{received.topic.name}")

    def _keep(self, received: Received) -> None:
        """Keep a latched message for the next files."""
        self._latched.keep(received)
        if self._latched.forgotten:
            self._health.put("latched/forgotten", self._latched.forgotten)

    def _count_written(self) -> None:
        """Add the batch to the counters: once for the whole batch, because each addition takes a lock."""
        for topic, messages in self._written.items():
            self._health.count(f"written/{topic}", messages)
        self._written.clear()

    def _sync(self) -> None:
        if self._attempt(lambda recording: recording.file.sync()):
            self._close_or_split()
        if self._recording is not None and self._recording.file.vanished:
            self._end_early(
                self._recording, OSError(errno.ENOENT, "the file has vanished from its directory")
            )

    def _close_or_split(self) -> None:
        """Close the file if the disk is full, or split it if it is large or old enough."""
        recording, config = self._recording, self._config
        if recording is None:
            return
        if recording.file.full:
            self._end_early(recording, OSError(errno.ENOSPC, "the disk is full"))
        elif not self._split_asked and (
            recording.file.size_bytes >= config.split_bytes
            or (config.split_interval_s and recording.age_s >= config.split_interval_s)
        ):
            self._split_asked = self._backlog.command(self._split)

    def _watch_clock(self, received: Received) -> None:
        offset_s = received.arrival_ns * 1e-9 - received.arrival_s
        jump_s = 0.0 if self._clock_offset_s is None else offset_s - self._clock_offset_s
        self._clock_offset_s = offset_s
        if abs(jump_s) > _CLOCK_JUMP_S:
            log.warning("this machine's clock jumped by %+.3f s; the log's times follow it", jump_s)
            self._health.count("clock/jumps")
            self._attempt(lambda recording: recording.note_clock_jump(jump_s))

    def _know(self, statuses: list[StatusReply]) -> None:
        for status in statuses:
            if status.name in self._services or len(self._services) < _MOST_SERVICES:
                self._services[status.name] = status
        self._attempt(lambda recording: recording.describe(self._services, self._version))

    # --- files ---

    def _open(
        self,
        name: str | None,
        received: Counter[str],
        *,
        continues: str | None = None,
        again: str = BY_QUERY,
    ) -> LogReply:
        if self._recording is not None:
            raise AlreadyRecordingError(self._recording.file.path)
        stem, config = name or self._stem, self._config
        try:
            settings = WriterSettings(
                config.bus.keys,
                f"rpod {self._version}",
                config.compression,
                config.chunk_bytes,
                config.reserve_bytes,
                lambda: time.monotonic() < self._full_until_s,
                chained=config.chained,
                key=signing_key(config),
            )
            file = create_log(config.directory, stem, settings)
        except (OSError, SecurityError) as error:  # the disk, or a key that cannot be read
            failure = CannotWriteError(config.directory / f"{stem}.mcap", error, again=again)
            raise self._fail(failure) from error
        self._stem, self._failure = stem, None
        if continues is None:
            self._endings(time.time_ns())  # publishers that ended before do not concern this file
        recording = self._recording = Recording(file, self._totals(received), continues=continues)
        self._attempt(lambda recording: recording.describe(self._services, self._version))
        self._attempt(lambda recording: recording.repeat(self._latched))
        if self._failure:
            raise self._failure
        log.info("recording to %s", file.path)
        return _reply(recording)

    def _close(self, received: Counter[str]) -> LogReply:
        recording = self._recording
        if recording is None:
            raise NotRecordingError
        totals = self._totals(received)
        endings = self._endings(recording.opened_ns)
        self._attempt(lambda recording: recording.close(totals, self._config.bus.keys, endings=endings))
        if self._failure:
            raise self._failure
        self._recording = None
        log.info("closed %s: %d messages", recording.file.path, recording.file.messages)
        return _reply(recording)

    def _renew(self, name: str | None, received: Counter[str]) -> LogReply:
        before = self._close(received)
        continued = Path(before.path).name
        try:
            return self._open(name, received, continues=continued)
        except CannotWriteError:
            if name is not None:  # the recording goes on under its own name; the caller gets the error
                self._open(None, received, continues=continued)
            raise

    def _split(self, received: Counter[str]) -> None:
        self._split_asked = False
        with suppress(LoggerError):  # logged where it happened
            self._renew(None, received)

    def _finish(self, received: Counter[str]) -> None:
        with suppress(LoggerError):  # logged where it happened
            self._close(received)

    def _end_early(self, recording: Recording, error: OSError) -> None:
        """Close the log if the disk still allows it; otherwise abandon it."""
        totals = self._totals(self._backlog.received())
        try:
            recording.close(
                totals,
                self._config.bus.keys,
                reasons=(str(error.strerror),),
                endings=self._endings(recording.opened_ns),
            )
        except OSError:
            self._abandon(recording, error)
        else:
            self._recording = None
            self._fail(CannotWriteError(recording.file.path, error, closed=True))

    def _attempt(self, work: Callable[[Recording], None]) -> bool:
        """Do work on the open log; return whether it succeeded. A log on which it fails is abandoned."""
        if self._recording is None:
            return False
        try:
            work(self._recording)
        except Exception as error:  # noqa: BLE001 - the daemon reports any error and goes on
            self._abandon(self._recording, error)
            return False
        return True

    def _abandon(self, recording: Recording, error: Exception) -> None:
        """Leave the log as it is; the messages of its open chunk are lost."""
        recording.file.abandon()
        self._recording = None
        self._count_written()
        for topic, messages in recording.file.pending.items():
            self._health.count(f"written/{topic}", -messages)
            self._health.count(f"lost/{topic}", messages)
        self._fail(CannotWriteError(recording.file.path, error, closed=False))

    def _fail(self, failure: CannotWriteError) -> CannotWriteError:
        """Report the failure; messages that arrive from now on are counted as lost."""
        if self._failure is None or str(failure) != str(self._failure):
            log.error("%s", failure)
        self._failure = failure
        self._health.report(Health.ERROR, str(failure))
        return failure

    def _totals(self, received: Counter[str]) -> Totals:
        totals = Totals(received)
        for key, count in list(self._account.counts.items()):
            topic = self._config.bus.keys.topic_at(key).name
            totals.missed[topic] += count.missed
            totals.recovered[topic] += count.recovered
            totals.duplicates[topic] += count.duplicates
        for name, number in self._health.counters().items():
            kind, _, rest = name.partition("/")
            topic, _, reason = rest.rpartition("/")
            if kind == "rejected" and reason != Reason.DUPLICATE:
                totals.rejected[topic] += number
        return totals


def _reply(recording: Recording) -> LogReply:
    file = recording.file
    return LogReply(path=str(file.path.resolve()), messages=file.messages, bytes=file.bytes)
