"""A batch of trials in a worker's process, and the transfer of an exception from there."""

import pickle
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rpod_campaign.engine.campaign import CELL, TRIAL, Row
from rpod_campaign.engine.errors import TrialFailedError
from rpod_campaign.engine.executor.port import Work
from rpod_schemas.errors import RpodError

Trial = Callable[[Any, int, int], Row | Sequence[Row]]
_EXPECTED = (RpodError, OSError, MemoryError)
"""Errors whose message is sufficient; others are faults of the software, reported with their traceback."""


@dataclass(frozen=True)
class Failure:
    """An exception of a trial in a form that every process can read."""

    trial: int
    kind: str
    message: str
    expected: bool
    trace: str
    pickled: bytes | None
    """The exception itself; None if it cannot be pickled and read again."""

    def raised(self, work: Work, cell: int) -> TrialFailedError:
        """Return the error to raise; its cause is the trial's own exception if that could be pickled."""
        error = TrialFailedError(
            work.place(cell, self.trial), self.kind, self.message, expected=self.expected, trace=self.trace
        )
        error.__cause__ = None if self.pickled is None else pickle.loads(self.pickled)  # noqa: S301
        return error


@dataclass(frozen=True)
class Outcome:
    """Result of a batch: the rows of the finished trials, and the exception that ended it."""

    cell: int
    trials: tuple[int, ...]
    """Numbers of the finished trials."""
    rows: tuple[Row, ...]
    """Rows of these trials, with cell and trial first."""
    took_s: float
    """Wall clock time of the batch, s."""
    failure: Failure | None = None


def run_batch(trial: Trial, cell: Any, index: int, seed: int, numbers: Sequence[int]) -> Outcome:
    """Run trials of one cell in order, up to the first that raises an exception.

    Args:
        trial: the campaign's trial.
        cell: parameters of the cell.
        index: index of the cell.
        seed: seed of all random numbers.
        numbers: numbers of the trials.
    """
    rows: list[Row] = []
    done: list[int] = []
    begin_s = time.perf_counter()
    for number in numbers:
        try:
            made = trial(cell, seed, number)
        except Exception as error:  # noqa: BLE001 - whatever it is, the process that waits reports it
            return _outcome(index, done, rows, begin_s, failure_of(number, error))
        several = [made] if isinstance(made, Mapping) else made
        rows += [{CELL: index, TRIAL: number, **row} for row in several]
        done.append(number)
    return _outcome(index, done, rows, begin_s, None)


def _outcome(
    index: int, done: Sequence[int], rows: Sequence[Row], begin_s: float, failure: Failure | None
) -> Outcome:
    return Outcome(index, tuple(done), tuple(rows), time.perf_counter() - begin_s, failure)


def failure_of(number: int, error: Exception) -> Failure:
    """Return a trial's exception in a form that every process can read."""
    trace = "".join(traceback.format_exception(error))
    expected = isinstance(error, _EXPECTED)
    return Failure(number, type(error).__name__, str(error), expected, trace, _pickled(error))


def _pickled(error: Exception) -> bytes | None:
    """Return the exception's bytes, or None if they cannot be unpickled, as for many classes."""
    try:
        pickled = pickle.dumps(error)
        pickle.loads(pickled)  # noqa: S301 - our own bytes
    except Exception:  # noqa: BLE001 - whatever a class's own methods raise
        return None
    return pickled
