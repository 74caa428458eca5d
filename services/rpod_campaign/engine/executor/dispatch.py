"""Transfer of batches to the workers of a cluster and back, over one connection to the scheduler."""

import time
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field
from enum import Enum
from threading import Event
from typing import Any, NamedTuple

from distributed import Client, Future, KilledWorker

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
    REFUSED = "refused"


@dataclass
class _Worker:
    """A worker as the client sees it."""

    address: str
    name: str
    question: Future[Answer]
    stage: _Stage = _Stage.ASKED
    running: list[tuple[Future[Delivery], Batch]] = field(default_factory=list)


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

    def run(self, address: str, *, patience_s: float) -> Generator[Arrived]:
        """Yield batches as they come back.

        Args:
            address: address of the scheduler, for messages.
            patience_s: longest time without a worker that may run the trials, s.

        Raises:
            SchedulerLostError: the connection is lost; the running batches are put back.
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
                    self._require_workers(address, patience_s)
        finally:
            self._give_all_back()

    def _look(self) -> None:
        """Update the list of workers."""
        self._looked_s = time.monotonic()
        try:
            scheduler = self._client.scheduler_info(n_workers=-1)
        except (OSError, TimeoutError) as error:
            raise SchedulerLostError from error
        self._require_connection()
        self._scheduler = self._scheduler or scheduler["id"]
        if scheduler["id"] != self._scheduler:  # restarted since: what it was sent before is lost
            raise SchedulerLostError
        info = scheduler["workers"]
        for address in self._workers.keys() - info.keys():
            self._ended(self._workers.pop(address))
        for address in info.keys() - self._workers.keys():
            question = self._submit(address, cluster_worker.hello, self._job)
            self._workers[address] = _Worker(address, str(info[address].get("name", address)), question)

    def _require_connection(self) -> None:
        if self._client.status != "running":
            raise SchedulerLostError

    def _require_workers(self, address: str, patience_s: float) -> None:
        if any(worker.stage is _Stage.READY for worker in self._workers.values()):
            self._useful_s = time.monotonic()
        elif time.monotonic() - self._useful_s > patience_s:
            silent = [
                f"worker {worker.name} at {worker.address}: it does not answer"
                for worker in self._workers.values()
                if worker.stage is _Stage.ASKED
            ]
            raise NoWorkersError(address, patience_s, [*self._refusals, *silent])

    def _feed(self) -> None:
        ready = [worker for worker in self._workers.values() if worker.stage is _Stage.READY]
        for _ in range(_WAITING):
            for worker in ready:
                if len(worker.running) < _WAITING and (batch := self._batches.take(len(ready))):
                    numbers = tuple(task.trial for task in batch)
                    future = self._submit(
                        worker.address, cluster_worker.run, self._job, batch[0].cell, numbers
                    )
                    worker.running.append((future, batch))

    def _submit(self, address: str, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        future: Future[Any] = self._client.submit(
            function, *arguments, workers=[address], allow_other_workers=False, pure=False
        )
        future.add_done_callback(lambda _: self._wake.set())  # type: ignore[no-untyped-call]
        return future

    def _collect(self) -> Iterator[Arrived]:
        self._require_connection()
        for worker in list(self._workers.values()):
            if worker.stage is _Stage.ASKED and worker.question.status != "pending":
                self._receive(worker)
            for future, batch in list(worker.running):
                if future.status == "pending":
                    continue
                worker.running.remove((future, batch))
                delivery = self._delivery(worker, future, batch)
                if delivery is not None:
                    yield self._arrived(batch, delivery)

    def _receive(self, worker: _Worker) -> None:
        """Process a worker's answer whether it may run the trials."""
        try:
            answer: Answer = worker.question.result(timeout=_RESULT_S)
        except TimeoutError:
            worker.question = self._submit(worker.address, cluster_worker.hello, self._job)
            return
        except Exception as error:  # noqa: BLE001 - whatever prevents an answer
            if worker.question.status == "cancelled":
                self._require_connection()
            answer = Answer(f"it cannot answer: {type(error).__name__}: {error}", ())
        if answer.missing and not answer.refusal:
            targets = {name: cached_target(name) for name in answer.missing}
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
        part = part_name(batch[0].cell, delivery.trials) if delivery.trials else ""
        return Arrived(batch, new, part, delivery.rows, delivery.failure)

    def _ended(self, worker: _Worker) -> None:
        """Put back the batches of a worker that ended."""
        for index, (future, batch) in enumerate(worker.running):
            future.cancel()  # type: ignore[no-untyped-call]
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

    def _give_all_back(self) -> None:
        for worker in self._workers.values():
            for _, batch in worker.running:
                self._batches.give_back(batch)
            worker.running.clear()
