"""Completeness of a log: its own record, checked against its content (ICD section 5)."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise

from rpod_analysis.log.log import Log
from rpod_analysis.log.log_file import LogFile
from rpod_schemas.logs import (
    BUS,
    COMPLETENESS,
    COUNTS,
    NUMBERS,
    PUBLISHERS,
    RECOVERY,
    BusRecord,
    Recovery,
    TopicCount,
    check_completeness,
)
from rpod_schemas.summary import LogCompleteness

_OUTAGE = "the logger had no link to the router for some of the time"


@dataclass(frozen=True)
class FileCompleteness:
    """Completeness of one file of a log."""

    name: str
    messages: int
    complete: bool | None
    """None if the file has no record: another program or an old version of the logger wrote it."""
    reasons: tuple[str, ...]
    """Reasons why the file is not complete, a sentence each."""
    continues: str | None = None
    """Name of the file after whose last message this one begins."""
    clock_jumps_s: tuple[float, ...] = ()
    bus: BusRecord = field(default_factory=BusRecord)
    """Outages of the link, and publishers whose last number is not known."""


@dataclass(frozen=True)
class CheckedCompleteness:
    """Completeness of a log over all its files."""

    files: tuple[FileCompleteness, ...]
    between: tuple[str, ...]
    """Gaps between files that should follow each other, a sentence each."""

    @property
    def complete(self) -> bool | None:
        """Whether the log holds every message published while it was open; None if no record says so."""
        answers = [file.complete for file in self.files]
        if False in answers or self.between:
            return False
        return None if None in answers else True

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reasons why the log is not complete, a sentence each, with the file's name if there are several."""
        one = len(self.files) == 1
        within = (
            reason if one else f"{file.name}: {reason}" for file in self.files for reason in file.reasons
        )
        return (*within, *self.between)

    @property
    def unconfirmed(self) -> tuple[str, ...]:
        """Publishers of other software that ended without stating their last number, a sentence each."""
        return tuple(text for file in self.files for text in file.bus.unconfirmed)

    def summary(self) -> LogCompleteness:
        """Return the completeness in the form of ``summary.json``."""
        return LogCompleteness(complete=self.complete, reasons=self.reasons, unconfirmed=self.unconfirmed)


def check_log_completeness(log: Log) -> CheckedCompleteness:
    """Return the completeness that a log records, checked against its content."""
    files = tuple(_of_file(file) for file in log.files)
    between = [
        f"{after.name} does not state that it continues {before.name}"
        for before, after in pairwise(files)
        if after.complete is not None and after.continues != before.name
    ]
    if files[0].continues:
        between.insert(0, f"{files[0].name} continues {files[0].continues}, which is missing")
    return CheckedCompleteness(files, tuple(between))


def _of_file(file: LogFile) -> FileCompleteness:
    name, messages = file.path.name, file.statistics.message_count
    if record := file.metadata(RECOVERY):
        try:
            reasons = _of_recovery(Recovery.model_validate_json(record["recovery"]))
        except (ValueError, KeyError):
            reasons = ("its record of the recovery cannot be read",)
        return FileCompleteness(name, messages, not reasons, reasons)
    record = file.metadata(COMPLETENESS)
    if not record:
        return FileCompleteness(name, messages, None, ())
    try:
        counts = file.metadata(COUNTS)
        checked = check_completeness(record, counts, _counted(file))
        checked = checked.with_reasons(tuple(_count_again(file.metadata(PUBLISHERS), counts)))
        bus = BusRecord.of_record(file.metadata(BUS))
        checked = checked.with_reasons(() if checked.reasons or not bus.outages else (_OUTAGE,))
    except ValueError:
        return FileCompleteness(name, messages, False, ("its record of completeness cannot be read",))
    return FileCompleteness(
        name,
        messages,
        checked.complete,
        checked.reasons,
        checked.continues,
        clock_jumps_s=checked.clock_jumps_s,
        bus=bus,
    )


def _of_recovery(recovery: Recovery) -> tuple[str, ...]:
    """Return the losses that remain after a recovery."""
    reasons = [] if recovery.closed else ["recovered from a log that was not closed: its end is not known"]
    if recovery.unreadable_bytes:
        reasons.append(
            f"{recovery.unreadable_bytes} bytes of the damaged log could not be read, "
            f"in {recovery.damaged_places} places"
        )
    if recovery.without_definition:
        reasons.append(
            f"{recovery.without_definition} messages are left out, because their channel is not defined"
        )
    reasons += [f"{name}: about {topic.lost} lost" for name, topic in recovery.topics.items() if topic.lost]
    return tuple(reasons)


def _count_again(publishers: Mapping[str, str], counts: Mapping[str, str]) -> Iterator[str]:
    """Yield the differences between the publishers' numbers and the counts. Raises ``ValueError``."""
    for topic, text in publishers.items():
        runs, count = NUMBERS.validate_json(text), TopicCount.model_validate_json(counts.get(topic, "{}"))
        held = sum(run.messages for run in runs)
        gaps = sum(run.last - run.first + 1 - run.messages for run in runs)
        counted = count.missed + count.lost + count.rejected
        if held != count.written:
            yield f"{topic}: {held} written by its publishers' numbers, {count.written} by the logger's count"
        if gaps > counted:
            yield f"{topic}: {gaps} missing in its publishers' numbers, {counted} by the logger's count"


def _counted(file: LogFile) -> Counter[str]:
    counts: Counter[str] = Counter()
    for channel, number in file.statistics.channel_message_counts.items():
        counts[file.summary.channels[channel].topic] += number
    return counts
