"""Replay of a log through the navigator, in one process; the result is the same, byte for byte, each time.

The estimator is that of the daemon; its time comes from the frames. Between two frames the time advances in
steps, as in the daemon, so that silence is detected at the same stamp.
"""

import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from rpod_analysis.errors import CannotWriteError, NoEstimatorError, NoSensorDataError, NothingReplayedError
from rpod_analysis.log import Log, Logged
from rpod_analysis.log.log_file import REPLAY, beside
from rpod_analysis.log.stamp_check import StampCheck
from rpod_analysis.replay.bodies import LoggedBodies
from rpod_analysis.replay.chaser import LoggedReadings, logged_commands, logged_imu
from rpod_analysis.replay.estimate_log import EstimateLog
from rpod_analysis.replay.frames import Event, Frames, FramesAsLive
from rpod_analysis.replay.holders import LoggedHolders
from rpod_analysis.replay.recorded_searches import RecordedSearches
from rpod_analysis.replay.resets import LoggedReset, LoggedResets
from rpod_analysis.replay.timeline import Timeline
from rpod_analysis.scoring.run import estimate_prefix
from rpod_estimator.estimator import Estimator
from rpod_estimator.frame_reader import FrameReader
from rpod_pose.measurement import Tick
from rpod_pose.navigation.state import Output
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.config.migration import check_logged
from rpod_schemas.rmw.cdr import NANOSECONDS
from rpod_schemas.texts import reason_of
from rpod_schemas.topics import (
    CONTRADICTION,
    ESTIMATES,
    STATUS,
    TF_STATIC,
    TRUTH,
    TRUTH_JOINTS,
    VALIDITY,
    Topic,
)
from rpod_schemas.types import Command, ImuReading, Integrity
from rpod_target import load_target

Inputs = tuple[LoggedReadings[ImuReading], LoggedReadings[Command], LoggedBodies]
"""What accompanies the frames of a log."""


@dataclass(frozen=True)
class Replayed:
    """Result of a replay."""

    out: Path
    """The new log: truth, the old estimates, and the new ones under ``replay``."""
    replaced: bool
    """Whether an older file was replaced by it."""
    prefix: str
    """Prefix of the logged estimates' topics."""
    frames: int
    """Number of frames given to the estimator."""
    missing: int
    """Number of frames that the live run used and that are not in the log."""
    refused: dict[str, int]
    """Number of messages that could not be used, by topic."""
    second_publisher: dict[str, int]
    """Number of messages that were not used because another publisher held the topic, by topic."""
    undivided: dict[str, int]
    """Number of publishers of each topic whose messages the log does not distinguish, so that all are
    used."""
    resets: int
    """Number of logged resets that were repeated."""
    unknown_resets: int
    """Number of logged resets whose request is not in the log, so that they were not repeated."""
    processing_s: tuple[float, ...]
    """Processing time of each frame on this machine, s."""


def configured_estimator(log: Log) -> EstimatorConfig:
    """Return the configuration of a log's estimator; if there are several, that of ``estimator``.

    Raises:
        NoEstimatorError: the log contains none.
        ConfigurationError: the configuration has another version and cannot be used.
    """
    found = {
        name: model for name, model in log.configuration.items() if {"prefix", "sensors"} <= model.keys()
    }
    name = EstimatorConfig.model_fields["instance"].default
    if not found:
        raise NoEstimatorError(log.paths[0])
    model = found.get(name) or next(iter(found.values()))
    source = f"{log.paths[0]}: configuration of the estimator"
    migrated = check_logged(EstimatorConfig, model, source=source)
    migrated.report(source)
    return migrated.config


def replay(
    log: Log,
    config: EstimatorConfig,
    *,
    out: Path | None = None,
    as_live: bool = False,
    start_s: float = 0.0,
    end_s: float | None = None,
    follow: Callable[[float], object] = lambda _: None,
) -> Replayed:
    """Run the estimator again on a log's sensor data.

    Args:
        log: log with sensor data.
        config: configuration of the estimator; its bus is not used.
        out: log to write, by default ``run.replay.mcap`` beside ``run.mcap``. An older one is replaced.
        as_live: whether to use only the frames that the live run used, in its order.
        start_s: beginning, from the beginning of the log; earlier latched messages are used too.
        end_s: end, from the beginning of the log.
        follow: called with the time from the beginning of the log, s, after each message.

    Raises:
        TargetError: the configured target cannot be loaded.
        AnalysisError: the log cannot be read, or the new one cannot be written.
    """
    new = out or beside(log.paths[0], REPLAY)
    if new.resolve() in {path.resolve() for path in log.paths}:
        raise CannotWriteError(new, "is the log itself; give another name with --out")
    replaced, target = new.exists(), load_target(config.target)
    recorded = RecordedSearches() if as_live else None
    estimator = Estimator(config, target, recorded.of if recorded else None)
    reader, old = _reader_of(log, config), estimate_prefix(log)
    copied, status_topic = _copied(log, old), STATUS.under(old).name
    used = StampCheck(log), (holders := LoggedHolders(log, reader.parts))
    frames = FramesAsLive(reader, *used, status_topic=status_topic) if as_live else Frames(reader, *used)
    inputs = _inputs(log, config, estimator)
    span_ns = _span_ns(log, start_s=start_s, end_s=end_s)
    told = LoggedResets.of(log, status_topic)
    feed = _Feed(estimator, frames, inputs, recorded, resets=told.since(span_ns[0]))
    try:
        with EstimateLog(new, log, config, target) as written:
            for logged in _relevant(log, reader, copied, span_ns):
                if logged.topic in copied:
                    written.copy(logged)
                written.add(feed.checked(frames.take(logged)), arrival_ns=logged.log_ns)
                follow((logged.log_ns - log.start_ns) / NANOSECONDS)
            written.add(feed.checked(frames.rest()), arrival_ns=written.last_ns)
            if not feed.processing_s:
                raise NothingReplayedError(log.paths[0], as_live=as_live)
    except OSError as error:
        raise CannotWriteError(new, reason_of(error)) from error
    return Replayed(
        out=new,
        replaced=replaced,
        prefix=old,
        frames=len(feed.processing_s),
        missing=frames.missing,
        refused=dict(frames.refused),
        second_publisher=dict(sum((each.unused for each in (holders, *inputs)), Counter())),
        undivided=holders.undivided,
        resets=feed.resets,
        unknown_resets=told.unknown,
        processing_s=tuple(feed.processing_s),
    )


def estimator_outputs(log: Log, config: EstimatorConfig) -> Iterator[Output]:
    """Yield the outputs of an estimator that processes every frame of a log's sensors, and write nothing.

    Raises:
        TargetError: the configured target cannot be loaded.
        AnalysisError: the log cannot be read.
    """
    reader = FrameReader(config.sensors)
    estimator = Estimator(config, load_target(config.target))
    inputs = _inputs(log, config, estimator)
    frames = Frames(reader, StampCheck(log), LoggedHolders(log, reader.parts))
    feed = _Feed(estimator, frames, inputs)
    for logged in log.messages(*(topic.name for topic in (*reader.latched, *reader.streams))):
        for output, _ in feed.outputs(frames.take(logged)):
            yield output
    for output, _ in feed.outputs(frames.rest()):
        yield output


def _inputs(log: Log, config: EstimatorConfig, estimator: Estimator) -> Inputs:
    """Return what accompanies the frames of a log."""
    return (
        logged_imu(log, config.dynamics, estimator.imu),
        logged_commands(log, estimator.commands),
        LoggedBodies(log, estimator.bodies),
    )


def _reader_of(log: Log, config: EstimatorConfig) -> FrameReader:
    """Return the reader of the sensors. Raises ``NoSensorDataError``: the log has no frames of them."""
    reader = FrameReader(config.sensors)
    wanted = [name for name, (sensor, part) in reader.parts.items() if part == reader.leading[sensor]]
    counts = {name: info.count for name, info in log.topics.items()}
    if not any(counts.get(name) for name in wanted):
        types = {topic.type for topic in reader.streams}
        others = [name for name, info in log.topics.items() if info.count and info.type in types]
        raise NoSensorDataError(log.paths[0], sorted(wanted), sorted(others))
    return reader


def _copied(log: Log, prefix: str) -> set[str]:
    """Return the names of the topics that are copied: truth, mounts, and estimates that are made anew."""
    anew = (topic for topic in ESTIMATES if topic not in (CONTRADICTION, VALIDITY))
    patterns = TRUTH, TRUTH_JOINTS, TF_STATIC, *(topic.under(prefix).at("*") for topic in anew)
    topics = (Topic(name, info.type) for name, info in log.topics.items())
    return {topic.name for topic in topics if any(pattern.covers(topic) for pattern in patterns)}


def _span_ns(log: Log, *, start_s: float, end_s: float | None) -> tuple[int | None, int | None]:
    """Return the times of arrival between which a log is replayed; None for its beginning or end."""
    timeline = Timeline(log)
    start_ns = timeline.arrival_of(timeline.begin(start_s)) if start_s else None
    return start_ns, None if end_s is None else timeline.arrival_of(timeline.at(end_s))


def _relevant(
    log: Log, reader: FrameReader, copied: set[str], span_ns: tuple[int | None, int | None]
) -> Iterator[Logged]:
    start_ns, end_ns = span_ns
    latched = [topic.name for topic in reader.latched]
    streams = [topic.name for topic in reader.streams]
    before = log.messages(*latched, end_ns=start_ns) if start_ns is not None else ()
    wanted = {*latched, *streams, *copied}
    return chain(before, log.messages(*wanted, start_ns=start_ns, end_ns=end_ns))


class _Feed:
    """Passes frames to the estimator, and advances its time between the frames.

    Args:
        estimator: the estimator.
        frames: the frames of the log.
        inputs: the log's readings of the chaser's motion, its commands, and the poses of known bodies.
        recorded: the searches of a live run, if its frames are repeated.
        resets: the resets to repeat.
    """

    def __init__(
        self,
        estimator: Estimator,
        frames: Frames,
        inputs: Inputs,
        recorded: RecordedSearches | None = None,
        *,
        resets: Sequence[LoggedReset] = (),
    ) -> None:
        self.processing_s: list[float] = []
        self.resets = 0
        """Number of resets that were repeated."""
        self._inputs, self._waiting = inputs, deque(resets)
        self._frames, self._reader = frames, frames.reader
        self._estimator, self._recorded = estimator, recorded

    def checked(self, events: Iterable[Event]) -> Iterator[tuple[Output, Integrity]]:
        """Yield the estimator's outputs, each with its integrity, as the daemon publishes them."""
        for output, frozen in self.outputs(events):
            yield output, self._estimator.integrity(output, frozen=frozen)

    def outputs(self, events: Iterable[Event]) -> Iterator[tuple[Output, bool]]:
        """Yield the estimator's outputs, and whether their frames were refused because the stream froze."""
        for event in events:
            self._estimator.learn(self._reader.infos)
            in_time = isinstance(event, Tick) or event.came_in_time
            if in_time:
                for heard in self._inputs:
                    heard.take_until(event.stamp_ns)
                self._reset_before(event.stamp_ns)
            if isinstance(event, Tick):
                if (output := self._estimator.tick(event.stamp_ns)) is not None:
                    yield output, False
                continue
            if self._recorded is None and in_time:
                for output in self._estimator.let_time_pass(event.stamp_ns):
                    yield output, False
            elif self._recorded is not None:  # the statuses show which ticks changed the mode
                self._recorded.evidence = event.evidence
            started_s = time.perf_counter()
            output = self._estimator.process(event)
            self.processing_s.append(time.perf_counter() - started_s)
            self._reader.pinned = self._estimator.pins_setups
            yield output, event.is_frozen

    def _reset_before(self, stamp_ns: int) -> None:
        """Repeat the resets that took effect at a frame or before it."""
        while self._waiting and self._waiting[0].stamp_ns <= stamp_ns:
            request = self._waiting.popleft().request
            self._frames.reset(request.keep_gid)
            self._estimator.request_reset(request)
            self.resets += 1
