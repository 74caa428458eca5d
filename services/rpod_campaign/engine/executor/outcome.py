"""A batch of trials in a worker's process, and how an exception travels from there."""

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
"""Errors whose message says enough; others are faults of the software, and their traceback is told too."""


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
        """Return the error to raise; the trial's own exception is its cause where it could travel."""
        error = TrialFailedError(
            work.place(cell, self.trial), self.kind, self.message, expected=self.expected, trace=self.trace
        )
        error.__cause__ = None if self.pickled is None else pickle.loads(self.pickled)  # noqa: S301
        return error


@dataclass(frozen=True)
class Outcome:
    """Result of a batch: the rows of the trials that finished, and the exception that ended it."""

    cell: int
    trials: tuple[int, ...]
    """Numbers of the trials that finished."""
    rows: tuple[Row, ...]
    """Rows of these, with cell and trial in front."""
    took_s: float
    """Wall clock time of the batch."""
    failure: Failure | None = None


def run_batch(trial: Trial, cell: Any, index: int, seed: int, numbers: Sequence[int]) -> Outcome:
    """Run trials of one cell in order, up to the first that raises.

    Args:
        trial: the campaign's.
        cell: its parameters.
        index: of the cell.
        seed: of all random numbers.
        numbers: of the trials.
    """
    rows: list[Row] = []
    done: list[int] = []
    begin_s = time.perf_counter()
    for number in numbers:
        try:
            made = trial(cell, seed, number)
        except Exception as error:  # noqa: BLE001 - told to whoever started the campaign, whatever it is
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
    """Return the exception's bytes if they can be read again: many classes' cannot."""
    try:
        pickled = pickle.dumps(error)
        pickle.loads(pickled)  # noqa: S301 - our own bytes
    except Exception:  # noqa: BLE001 - whatever a class's own methods raise
        return None
    return pickled
