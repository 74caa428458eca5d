"""Transfer of batches to the workers of a cluster and back, over one connection to the scheduler."""

import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from threading import Event
from typing import Any, NamedTuple

from distributed import CancelledError, Client, Future, KilledWorker
from distributed.client import ClosedClientError

from rpod_campaign.engine.errors import CampaignError, NoWorkersError, WorkerDiedError
from rpod_campaign.engine.executor import cluster_worker
from rpod_campaign.engine.executor.batches import Batch, Batches
from rpod_campaign.engine.executor.cluster_worker import Answer, Delivery, Job, part_name
from rpod_campaign.engine.executor.outcome import Failure
from rpod_campaign.engine.executor.port import Work
from rpod_campaign.engine.trial.targets import cached_target

_WAITING = 2
"""Number of batches of a worker: the running one, and the next."""
_LOOK_S = 0.5
"""Interval at which the list of workers is updated, s."""
_RESULT_S = 10.0
"""Longest time for the transfer of an available answer, s."""
_SCHEDULER_S = 20.0
"""Longest time for an answer of the scheduler, s; after it the connection is taken as lost."""
_LONG = 5.0
"""Time over that of the longest batch so far after which a worker is taken as silent."""
_MOST_ENDED = 3
"""Number of workers that end while they run a trial after which the trial is taken as the cause."""


class SchedulerLostError(CampaignError):
    """Raised if the connection to the scheduler is lost, and with it all running trials."""


class Arrived(NamedTuple):
    """A batch that came back."""

    batch: Batch
    new: tuple[int, ...]
    """Numbers of the trials that finished for the first time."""
    part: str
    """Name of the part of the folder for the rows."""
    rows: bytes | None
    """Parquet, if the worker could not write them into the folder."""
    failure: Failure | None


class _Stage(Enum):
    ASKED = "asked"
    """The worker was asked whether it may run the trials."""
    READY = "ready"
    SILENT = "silent"
    """No batch has come back for a long time. The worker was asked again, and others may run its trials
    too."""
    REFUSED = "refused"


@dataclass
class _Worker:
    """A worker as the client sees it."""

    address: str
    name: str
    question: Future[Answer]
    stage: _Stage = _Stage.ASKED
    running: list[tuple[Future[Delivery], Batch]] = field(default_factory=list)
    since_s: float = 0.0
    """Time since which it has had trials and no batch has come back, s."""
    patience_s: float = 0.0
    """Time after which the user is told again that it is silent, s."""

    def drop_lost(self) -> None:
        """Forget its batches if it has answered a question that it was asked after them."""
        for future, batch in list(self.running):
            if future.status == "pending":
                self.running.remove((future, batch))
                _cancel(future)


class Dispatch:
    """Supplies the workers until all trials are finished, or the scheduler is lost."""

    def __init__(
        self, client: Client, work: Work, job: Job, batches: Batches, *, note: Callable[[str], None]
    ) -> None:
        self._client, self._work, self._job, self._batches, self._note = client, work, job, batches, note
        self._scheduler = ""
        self._workers: dict[str, _Worker] = {}
        self._refusals: list[str] = []
        self._wake = Event()
        self._looked_s = self._useful_s = time.monotonic()
        self._longest_s = 0.0
        """Time of the longest batch so far, s."""

    def run(
        self, address: str, *, patience_s: float, complete: Callable[[], None] = lambda: None
    ) -> Generator[Arrived]:
        """Yield batches as they come back.

        Args:
            address: address of the scheduler, for messages.
            patience_s: longest time without a worker that may run the trials, s.
            complete: starts the workers of the cluster that are missing, where there are none.

        Raises:
            SchedulerLostError: the connection is lost; the unfinished trials are put back.
            WorkerDiedError, NoWorkersError, CampaignError: the trials cannot be run any further.
        """
        try:
            self._look()
            while self._batches.left:
                self._feed()
                self._wake.wait(_LOOK_S)
                self._wake.clear()
                yield from self._collect()
                if time.monotonic() - self._looked_s > _LOOK_S:
                    self._look()
                    if not self._workers:
                        complete()
                    self._require_workers(address, patience_s)
                    self._watch(patience_s)
        finally:
            self._batches.put_all_back()

    def _look(self) -> None:
        """Update the list of workers."""
        self._looked_s = time.monotonic()
        # Not scheduler_info(): without an answer it returns what it knew before, and in between no workers.
        with _over_the_connection():
            client: Any = self._client  # its annotations are incomplete
            scheduler = client.sync(client.scheduler.identity, n_workers=-1, callback_timeout=_SCHEDULER_S)
        self._require_connection()
        self._scheduler = self._scheduler or scheduler["id"]
        if scheduler["id"] != self._scheduler:  # restarted since: what it was sent before is lost
            raise SchedulerLostError
        info = scheduler["workers"]
        for address in self._workers.keys() - info.keys():
            self._ended(self._workers.pop(address))
        for address in info.keys() - self._workers.keys():
            question = self._submit(address, cluster_worker.check_worker, self._job)
            self._workers[address] = _Worker(address, str(info[address].get("name", address)), question)

    def _require_connection(self) -> None:
        if self._client.status != "running":
            raise SchedulerLostError

    def _require_workers(self, address: str, patience_s: float) -> None:
        if any(worker.stage in (_Stage.READY, _Stage.SILENT) for worker in self._workers.values()):
            self._useful_s = time.monotonic()
        elif time.monotonic() - self._useful_s > patience_s:
            silent = [
                f"worker {worker.name} at {worker.address}: it does not answer"
                for worker in self._workers.values()
                if worker.stage is _Stage.ASKED
            ]
            raise NoWorkersError(address, patience_s, [*self._refusals, *silent])

    def _watch(self, patience_s: float) -> None:
        """Let others run the trials of a worker that has been silent for a long time, and ask it again.

        Its trials may take long, or the scheduler may have lost them: both look the same from here. In the
        first case the batch counts when it comes. In the second the worker answers and gets other trials.
        """
        now_s, least_s = time.monotonic(), max(patience_s, _LONG * self._longest_s)
        for worker in self._workers.values():
            silent_s = now_s - worker.since_s
            if not worker.running or silent_s <= max(least_s, worker.patience_s):
                continue
            worker.patience_s = 2.0 * silent_s
            self._note(
                f"worker {worker.name} at {worker.address}: no trial came back for {silent_s:.0f} s; "
                "others may run its trials too"
            )
            if worker.stage is _Stage.READY:
                worker.stage = _Stage.SILENT
                for _, batch in worker.running:
                    self._batches.share(batch)
                worker.question = self._submit(worker.address, cluster_worker.check_worker, self._job)

    def _feed(self) -> None:
        ready = [worker for worker in self._workers.values() if worker.stage is _Stage.READY]
        for _ in range(_WAITING):
            for worker in ready:
                idle = not worker.running
                full = len(worker.running) >= _WAITING or any(
                    self._batches.runs_alone(batch) for _, batch in worker.running
                )
                if not full and (batch := self._batches.take(len(ready), idle=idle)):
                    if idle:
                        worker.since_s = time.monotonic()
                    numbers = tuple(task.trial for task in batch)
                    future = self._submit(
                        worker.address, cluster_worker.run, self._job, batch[0].cell, numbers
                    )
                    worker.running.append((future, batch))

    def _submit(self, address: str, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        with _over_the_connection():
            future: Future[Any] = self._client.submit(
                function, *arguments, workers=[address], allow_other_workers=False, pure=False
            )
            future.add_done_callback(lambda _: self._wake.set())  # type: ignore[no-untyped-call]
        return future

    def _collect(self) -> Iterator[Arrived]:
        self._require_connection()
        for worker in list(self._workers.values()):
            for future, batch in list(worker.running):
                if future.status == "pending":
                    continue
                worker.running.remove((future, batch))
                worker.since_s, worker.patience_s = time.monotonic(), 0.0
                delivery = self._delivery(worker, future, batch)
                if delivery is not None:
                    yield self._arrived(batch, delivery)
            waits = worker.stage in (_Stage.ASKED, _Stage.SILENT)
            if waits and worker.question.status != "pending":
                self._receive(worker)

    def _receive(self, worker: _Worker) -> None:
        """Process a worker's answer whether it may run the trials."""
        try:
            answer: Answer = worker.question.result(timeout=_RESULT_S)
        except TimeoutError:
            worker.question = self._submit(worker.address, cluster_worker.check_worker, self._job)
            return
        except Exception as error:  # noqa: BLE001 - whatever prevents an answer
            if worker.question.status == "cancelled":
                self._require_connection()
            answer = Answer(f"it cannot answer: {type(error).__name__}: {error}", ())
        worker.drop_lost()
        if answer.missing and not answer.refusal:
            targets = {name: cached_target(name) for name in answer.missing}
            with _over_the_connection():
                sent = self._client.scatter(targets, workers=[worker.address], hash=False)  # type: ignore[no-untyped-call]
            worker.question = self._submit(worker.address, cluster_worker.take_targets, self._job, sent)
        elif answer.refusal:
            worker.stage = _Stage.REFUSED
            refusal = f"worker {worker.name} at {worker.address}: {answer.refusal}"
            self._refusals.append(refusal)
            self._note(f"refused: {refusal}")
        else:
            worker.stage = _Stage.READY

    def _delivery(self, worker: _Worker, future: Future[Delivery], batch: Batch) -> Delivery | None:
        """Return the result of a batch; None if it was lost in transfer, and the batch is put back."""
        if future.status == "finished":
            try:
                delivery: Delivery = future.result(timeout=_RESULT_S)
            except Exception:  # noqa: BLE001 - the worker ended before its answer was fetched
                self._batches.give_back(batch)
                return None
            return delivery
        self._require_connection()
        error = future.exception() if future.status == "error" else None  # type: ignore[no-untyped-call]
        if error is not None and not isinstance(error, KilledWorker):
            raise CampaignError(f"worker {worker.name} at {worker.address}: {type(error).__name__}: {error}")
        self._batches.give_back(batch)
        return None

    def _arrived(self, batch: Batch, delivery: Delivery) -> Arrived:
        new = self._batches.finish(batch, delivery.trials, delivery.took_s)
        self._longest_s = max(self._longest_s, delivery.took_s)
        part = part_name(batch[0].cell, delivery.trials) if delivery.trials else ""
        return Arrived(batch, new, part, delivery.rows, delivery.failure)

    def _ended(self, worker: _Worker) -> None:
        """Put back the batches of a worker that ended."""
        for index, (future, batch) in enumerate(worker.running):
            _cancel(future)
            if index:
                self._batches.give_back(batch)
                continue
            task, times = self._batches.worker_ended(batch)
            if times >= _MOST_ENDED:
                how = f"ended {times} times in a row, by lack of memory or a fault in compiled code,"
                raise WorkerDiedError(how, [self._work.place(*task)])
        if worker.running:
            self._note(f"worker {worker.name} at {worker.address} ended; its trials go to others")
        worker.running.clear()


@contextmanager
def _over_the_connection() -> Iterator[None]:
    """Raise SchedulerLostError if a call fails because the connection to the scheduler does."""
    try:
        yield
    except (OSError, ClosedClientError, CancelledError) as error:  # a TimeoutError is an OSError
        raise SchedulerLostError from error


def _cancel(future: Future[Any]) -> None:
    with _over_the_connection():
        future.cancel()  # type: ignore[no-untyped-call]
