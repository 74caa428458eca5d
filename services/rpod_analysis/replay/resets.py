"""Resets of the estimator that a log records: its diagnostics count them and keep the last request.

A reset takes effect at the next frame, and is in the diagnostics a moment later. If the statuses between two
diagnostics show that the track ended without being lost, the reset took effect there. Otherwise it is
repeated after the last status before the diagnostics.
"""

from dataclasses import dataclass

from pydantic import ValidationError

from rpod_analysis.log import Log, Logged
from rpod_schemas.control import ResetRequest
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import read_diagnostics, read_status
from rpod_schemas.texts import is_count
from rpod_schemas.topics import DIAGNOSTICS
from rpod_schemas.types import PUBLISHED, Diagnostic, Mode

_COUNT, _REQUEST = "commands/reset", "command/reset"
_BEFORE_NS = 1_000_000_000
"""Time before two diagnostics from which statuses tell whether there was a track."""


@dataclass(frozen=True)
class LoggedReset:
    """A reset."""

    stamp_ns: int
    """Stamp of the first frame after it."""
    request: ResetRequest
    told_ns: int
    """Time of arrival of the diagnostics that record it."""


@dataclass(frozen=True)
class LoggedResets:
    """The resets of a log."""

    resets: tuple[LoggedReset, ...] = ()
    """Resets in their order."""
    unknown: int = 0
    """Number of resets whose request is not in the log, because another one followed at once."""

    @classmethod
    def of(cls, log: Log, status_topic: str) -> "LoggedResets":
        """Return the resets of the estimator that publishes a status."""
        found: list[LoggedReset] = []
        before: int | None = None
        told_ns, unknown = log.start_ns, 0
        for logged in log.messages(DIAGNOSTICS):
            for diagnostic in _read(log, logged):
                text = diagnostic.values.get(_COUNT, "0")
                if PUBLISHED + status_topic not in diagnostic.values or not is_count(text):
                    continue
                count = int(text)
                new = 0 if before is None else count - before if count >= before else count
                before = count
                if new:
                    unknown += new - 1
                    try:
                        request = ResetRequest.model_validate_json(diagnostic.values.get(_REQUEST, ""))
                    except ValidationError:
                        unknown += 1
                    else:
                        stamp_ns = _effect_ns(log, status_topic, told_ns, logged.log_ns)
                        found.append(LoggedReset(stamp_ns, request, logged.log_ns))
                told_ns = logged.log_ns
        return cls(tuple(found), unknown)

    def since(self, begin_ns: int | None) -> list[LoggedReset]:
        """Return the resets that were recorded at a time of arrival or later; all of them if it is None."""
        return [reset for reset in self.resets if begin_ns is None or reset.told_ns >= begin_ns]


def _read(log: Log, logged: Logged) -> list[Diagnostic]:
    with log.unreadable.left_out(logged):
        return read_diagnostics(logged.decode())
    return []


def _effect_ns(log: Log, status_topic: str, from_ns: int, until_ns: int) -> int:
    """Return the stamp of the first frame after a reset that was recorded between two times of arrival."""
    tracked, last_ns = False, 0
    for logged in log.messages(status_topic, start_ns=from_ns - _BEFORE_NS, end_ns=until_ns + 1):
        try:
            status = read_status(logged.decode())
        except MessageRejectedError:
            continue
        ends = tracked and not status.mode.has_track and status.mode is not Mode.LOST
        if ends and logged.log_ns > from_ns:
            return status.stamp_ns
        tracked, last_ns = status.mode.has_track, max(last_ns, status.stamp_ns)
    return last_ns + 1
