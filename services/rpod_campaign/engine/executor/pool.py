"""Trials on this machine's cores, in new processes with one thread each."""

import multiprocessing
import os
import signal
import time
from collections.abc import Generator, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from multiprocessing.process import BaseProcess

from rpod_campaign.engine.errors import WorkerDiedError
from rpod_campaign.engine.executor.outcome import Outcome, run_batch
from rpod_campaign.engine.executor.port import Finished, Task, Work
from rpod_runtime.process.load import cores

ONE_THREAD = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "POLARS_MAX_THREADS",
)
_WAITING = 2
"""Number of trials in the queue for each process: enough to keep it busy, and few that can be lost."""
_EXIT_S = 5.0
"""Longest wait for the exit code of a process that ended, s."""
_POLL_S = 0.01


@dataclass
class _Processes:
    """A pool and its processes, whose exit codes remain available after the pool has dropped them."""

    executor: ProcessPoolExecutor
    foreign: frozenset[BaseProcess]
    started: set[BaseProcess] = field(default_factory=set)

    def submit(self, work: Work, task: Task) -> Future[Outcome]:
        """Return the future of a trial."""
        cell = work.cells[task.cell]
        future = self.executor.submit(
            run_batch, work.campaign.trial, cell, task.cell, work.options.seed, (task.trial,)
        )
        self.started |= set(multiprocessing.active_children()) - self.foreign
        return future

    def why_ended(self) -> str:
        """Return how the first process ended that did not end normally."""
        deadline_s = time.monotonic() + _EXIT_S
        for process in self.started:
            process.join(_EXIT_S)
            while process.exitcode is None and time.monotonic() < deadline_s:
                time.sleep(_POLL_S)  # the pool's own thread may have reaped it, and soon sets the code
        codes = [process.exitcode for process in self.started if process.exitcode]
        first = next((code for code in codes if code != -signal.SIGTERM), None)
        return how_ended(first if first is not None else next(iter(codes), None))


@dataclass(frozen=True)
class ProcessPool:
    """Executor on the cores of this machine."""

    jobs: int
    """Number of processes; with 1 the trials run in one process beside this one."""

    def described(self) -> Mapping[str, str]:
        """Return the number of processes and cores, for the report."""
        return {"processes": f"{self.jobs} on {cores()} cores"}

    def run(self, work: Work, tasks: Iterable[Task]) -> Generator[Finished]:
        """Yield trials as they finish; see the port. Raises WorkerDiedError if a process ends early."""
        remaining = iter(tasks)
        first = list(islice(remaining, _WAITING * self.jobs))
        if not first:
            return
        with _processes(min(self.jobs, len(first))) as processes:
            pending = {processes.submit(work, task): task for task in first}
            try:
                while pending:
                    done, _ = wait(pending, return_when=FIRST_COMPLETED)
                    # finished trials before failed ones, and of each the first trial first
                    for future in sorted(done, key=lambda one: (_broken(one), pending[one])):
                        yield from _finished(work, future.result())
                        del pending[future]
                    for task in islice(remaining, len(done)):
                        pending[processes.submit(work, task)] = task
            except BrokenProcessPool as error:
                running = [work.place(*task) for task in list(pending.values())[: self.jobs]]
                raise WorkerDiedError(processes.why_ended(), running) from error


def _finished(work: Work, outcome: Outcome) -> Iterator[Finished]:
    if outcome.trials:
        yield Finished(outcome.cell, outcome.trials, outcome.rows)
    if outcome.failure is not None:
        raise outcome.failure.raised(work, outcome.cell)


def _broken(future: Future[Outcome]) -> bool:
    return future.exception() is not None or future.result().failure is not None


def how_ended(exit_code: int | None) -> str:
    """Return the meaning of an exit code and its usual cause, in words."""
    if exit_code is None:
        return "ended, and its exit code is not known"
    if exit_code >= 0:
        return f"ended with exit code {exit_code}"
    number = -exit_code
    name = signal.Signals(number).name if number in set(signal.Signals) else f"signal {number}"
    if number == signal.SIGKILL:
        return f"was killed by {name}, by the kernel if memory ran out: try fewer --jobs"
    if number in (signal.SIGSEGV, signal.SIGBUS, signal.SIGILL, signal.SIGABRT, signal.SIGFPE):
        return f"crashed by {name}, a fault in compiled code"
    return f"was ended by {name}"


@contextmanager
def _processes(jobs: int) -> Iterator[_Processes]:
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    executor = ProcessPoolExecutor(
        jobs, mp_context=multiprocessing.get_context("spawn"), initializer=_leave_interrupts_to_the_parent
    )
    processes = _Processes(executor, frozenset(multiprocessing.active_children()))
    try:
        yield processes
    except BaseException:
        for child in processes.started:
            child.terminate()
        raise
    finally:
        executor.shutdown(wait=True, cancel_futures=True)
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def _leave_interrupts_to_the_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
