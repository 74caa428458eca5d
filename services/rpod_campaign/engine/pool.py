"""Trials on all cores: processes that are started afresh, each with one thread of its own."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from typing import Any

from rpod_analysis.errors import AnalysisError
from rpod_campaign.engine.campaign import Row

_ONE_THREAD = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "POLARS_MAX_THREADS",
)
_WAITING = 2
"""Trials in the queue for each process: enough to keep it busy, few to give up."""

Trial = Callable[[Any, int, int], Row | Sequence[Row]]
Task = tuple[int, Any, int]
"""Index of a cell, the cell, number of a trial."""


class WorkerDiedError(AnalysisError):
    """A process of the trials was ended from outside."""

    def __init__(self) -> None:
        super().__init__("a process of the trials was killed, for want of memory perhaps; try fewer --jobs")


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_trials(trial: Trial, seed: int, tasks: Iterable[Task], *, jobs: int) -> Generator[list[Row]]:
    """Yield the rows of each trial as it finishes, with cell and trial in front.

    Whoever stops early, by an exception or by closing the generator, stops the processes at once.

    Args:
        trial: a function of a module.
        seed: of all randomness.
        tasks: what is to be run.
        jobs: number of processes; 1 is one process beside this one, too.

    Raises:
        WorkerDiedError: a process was killed.
    """
    remaining = iter(tasks)
    with _processes(jobs) as executor:

        def submitted(count: int) -> set[Future[list[Row]]]:
            return {executor.submit(_run, trial, seed, task) for task in islice(remaining, count)}

        try:
            pending = submitted(_WAITING * jobs)
            while pending:
                done, pending = wait(pending, return_when=FIRST_COMPLETED)
                for future in sorted(done, key=_failed):  # what is done is told before what failed
                    yield future.result()
                pending |= submitted(len(done))
        except BrokenProcessPool as error:
            raise WorkerDiedError from error


def _failed(future: Future[list[Row]]) -> bool:
    return future.exception() is not None


def _run(trial: Trial, seed: int, task: Task) -> list[Row]:
    index, cell, number = task
    made = trial(cell, seed, number)
    rows = [made] if isinstance(made, Mapping) else made
    return [{"cell": index, "trial": number, **row} for row in rows]


@contextmanager
def _processes(jobs: int) -> Iterator[ProcessPoolExecutor]:
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    executor = ProcessPoolExecutor(
        jobs, mp_context=multiprocessing.get_context("spawn"), initializer=_leave_interrupts_to_the_parent
    )
    children = set(multiprocessing.active_children())
    try:
        yield executor
    except BaseException:
        for child in set(multiprocessing.active_children()) - children:
            child.terminate()
        raise
    finally:
        executor.shutdown(wait=True, cancel_futures=True)
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def _leave_interrupts_to_the_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
