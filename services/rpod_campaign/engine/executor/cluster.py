"""Trials on the workers of a Dask cluster (distributed), for campaigns that need more than one machine.

The client gives each accepted worker up to two batches. If a worker ends, a scheduler restarts or a client is
lost, only the running trials are lost and no finished ones: rows are in the folder before a batch counts as
finished, and a trial counts once.
"""

import io
import logging
import re
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

import polars as pl
from dask import config as dask_config
from distributed import Client, LocalCluster

from rpod_campaign.engine.errors import NoSchedulerError
from rpod_campaign.engine.executor.batches import Batches
from rpod_campaign.engine.executor.cluster_worker import Job, cells_digest
from rpod_campaign.engine.executor.dispatch import Arrived, Dispatch, SchedulerLostError
from rpod_campaign.engine.executor.pool import ONE_THREAD
from rpod_campaign.engine.executor.port import Finished, Task, Work
from rpod_campaign.engine.software import identity
from rpod_schemas.errors import ConfigurationError

_LOCAL = re.compile(r"local:([1-9]\d{0,3})")
_REMOTE = re.compile(r"(tcp|tls|ws|wss)://\S+:\d+")
PATIENCE_S = 60.0
"""Longest wait for a scheduler, or for a worker, s."""
_CONNECT_S = 5.0
"""Longest attempt to reach a scheduler, s."""


def check_address(address: str) -> None:
    """Raise ConfigurationError for an invalid address."""
    if not _LOCAL.fullmatch(address) and not _REMOTE.fullmatch(address):
        raise ConfigurationError(
            "--cluster", "", f"needs tcp://HOST:PORT of a Dask scheduler, or local:N, not {address!r}"
        )


class Cluster:
    """Executor on the workers of a Dask scheduler, or of one that it starts on this machine."""

    def __init__(
        self, address: str, *, note: Callable[[str], None] = lambda _: None, patience_s: float = PATIENCE_S
    ) -> None:
        """Set the executor up; nothing is connected before trials are run.

        Args:
            address: tcp://host:port of a scheduler, or ``local:N`` for N workers on this machine.
            note: function that receives messages on refused or lost workers.
            patience_s: longest wait for the scheduler, and for a worker, s.
        """
        check_address(address)
        self._address, self._note, self._patience_s = address, note, patience_s

    def described(self) -> Mapping[str, str]:
        """Return the address of the cluster, for the report."""
        return {"cluster": self._address}

    def run(self, work: Work, tasks: Iterable[Task]) -> Generator[Finished]:
        """Yield trials as they finish; see the port. Their rows are in the folder.

        Raises:
            TrialFailedError: a trial raised an exception.
            WorkerDiedError: several workers ended while they ran the same trial.
            NoSchedulerError, NoWorkersError: no scheduler, or no worker, answered in time.
        """
        batches = Batches(tasks)
        if not batches.left:
            return
        job = _job(work)
        with _quiet(), _scheduler(self._address) as (address, complete):
            while batches.left:
                with self._connection(address) as client, suppress(SchedulerLostError):
                    dispatch = Dispatch(client, work, job, batches, note=self._note)
                    for arrived in dispatch.run(address, patience_s=self._patience_s, complete=complete):
                        _keep(work, arrived)
                        if arrived.new:
                            yield Finished(arrived.batch[0].cell, arrived.new, None)
                        if arrived.failure is not None:
                            raise arrived.failure.raised(work, arrived.batch[0].cell)
                    continue
                self._note(f"{address}: the scheduler does not answer; trying again")

    @contextmanager
    def _connection(self, address: str) -> Iterator[Client]:
        client = self._connected(address)
        try:
            yield client
        finally:
            with suppress(OSError):  # a lost scheduler does not answer the request to close either
                client.close()  # type: ignore[no-untyped-call]

    def _connected(self, address: str) -> Client:
        begin_s, tried_s = time.monotonic(), min(_CONNECT_S, self._patience_s)
        while True:
            try:
                return Client(address, timeout=tried_s, set_as_default=False)  # type: ignore[no-untyped-call]
            except (OSError, TimeoutError) as error:
                waited_s = time.monotonic() - begin_s
                if waited_s > self._patience_s:
                    raise NoSchedulerError(address, self._patience_s, str(error)) from error
                time.sleep(0.2)


def _job(work: Work) -> Job:
    return Job(
        campaign=work.campaign.name,
        options=work.options.model_dump_json(),
        cells=cells_digest(work.cells),
        software=identity(work.campaign),
        targets=dict(work.targets),
        folder=str(work.folder.path.resolve()),
        manifest=work.folder.manifest_digest(),
    )


def _keep(work: Work, arrived: Arrived) -> None:
    """Write rows that a worker could not write itself."""
    if arrived.rows is not None:
        work.folder.write_part(arrived.part, pl.read_parquet(io.BytesIO(arrived.rows)))


@contextmanager
def _scheduler(address: str) -> Iterator[tuple[str, Callable[[], None]]]:
    """Yield the scheduler's address, and a function that starts missing workers; ``local:N`` is started here.

    Dask does not restart a worker that ended before its start was complete.
    """
    local = _LOCAL.fullmatch(address)
    if local is None:
        yield address, lambda: None
        return
    environment = dict.fromkeys(ONE_THREAD, "1")
    start: Any = LocalCluster  # its annotations are incomplete
    with (
        dask_config.set({"distributed.nanny.pre-spawn-environ": environment}),
        start(
            n_workers=int(local[1]),
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        ) as cluster,
    ):
        yield str(cluster.scheduler_address), partial(cluster.scale, int(local[1]))


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Dask's log from the terminal: notes and errors report what is relevant."""
    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(before)
