"""Worker of a cluster: it answers whether it may run a campaign's trials, and runs them.

A batch arrives as (campaign, options, numbers of trials). The worker finds the campaign in its own catalogue,
makes the same cells from the same options, and writes the rows into the campaign's folder if it can access
it; otherwise the rows return with the answer.
"""

import hashlib
import io
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

import polars as pl

from rpod_campaign.catalogue import find
from rpod_campaign.engine.campaign import AnyCampaign
from rpod_campaign.engine.errors import CampaignUnknownError
from rpod_campaign.engine.executor.outcome import Failure, failure_of, run_batch
from rpod_campaign.engine.folder import CampaignFolder, cell_parameters
from rpod_campaign.engine.software import differences, identity
from rpod_campaign.engine.trial.targets import missing_targets, provide_targets
from rpod_target import Target

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables that must be 1: with several threads, sums of floating-point numbers depend on the
machine."""
_LOCK = Lock()
"""Lock for one trial at a time, whatever number of threads the worker has: methods keep buffers."""


@dataclass(frozen=True)
class Job:
    """A campaign in a form that is sent to workers."""

    campaign: str
    """Name of the campaign in the catalogue."""
    options: str
    """JSON of the campaign's options."""
    cells: str
    """Digest of the cells that the options make."""
    software: Mapping[str, str]
    """Versions and digests that must be equal on both sides."""
    targets: Mapping[str, str]
    """Digests of the targets, by name."""
    folder: str
    """Path of the campaign's folder, as the client sees it."""
    manifest: str
    """Digest of the folder's manifest, by which a worker recognises the folder."""

    def __hash__(self) -> int:
        return hash((self.campaign, self.options, self.cells, self.folder))


class Answer(NamedTuple):
    """Whether a worker may run a job's trials."""

    refusal: str
    """Reason for a refusal; empty if there is none."""
    missing: tuple[str, ...]
    """Names of the targets that have to be sent to it first."""


class Delivery(NamedTuple):
    """Result of a batch."""

    trials: tuple[int, ...]
    """Numbers of the finished trials."""
    rows: bytes | None
    """Their rows as Parquet; None if they are in the folder, or if there are none."""
    took_s: float
    """Wall clock time of the batch, s."""
    failure: Failure | None


def check_worker(job: Job) -> Answer:
    """Return whether this worker may run a job's trials; any error is a refusal."""
    try:
        return _answer(job)
    except Exception as error:  # noqa: BLE001 - an exception may not be picklable, an answer is
        return Answer(f"{type(error).__name__}: {error}", ())


def _answer(job: Job) -> Answer:
    with _LOCK:
        threads = [name for name in _ONE_THREAD if os.environ.get(name) != "1"]
        if threads:
            return Answer(f"{threads[0]} is {os.environ.get(threads[0], 'not set')}, not 1", ())
        try:
            campaign = find(job.campaign)
        except CampaignUnknownError as error:
            return Answer(str(error), ())
        other = differences(dict(job.software), identity(campaign))
        if other:
            return Answer("; ".join(other), ())
        missing, used = missing_targets(job.targets)
        if used:
            return Answer(f"it used another target {used[0]!r} before, restart it", ())
        return Answer("" if missing else _cells_differ(job), missing)


def take_targets(job: Job, targets: Mapping[str, Target]) -> Answer:
    """Store the targets whose files are not on this machine, and answer like ``check_worker``."""
    with _LOCK:
        provide_targets(targets)
    return check_worker(job)


def run(job: Job, cell: int, numbers: Sequence[int]) -> Delivery:
    """Run trials of one cell, up to the first that raises an exception."""
    try:
        return _delivery(job, cell, numbers)
    except Exception as error:  # noqa: BLE001 - such as a full disk; an exception may not be picklable
        return Delivery((), None, 0.0, failure_of(numbers[0], error))


def _delivery(job: Job, cell: int, numbers: Sequence[int]) -> Delivery:
    with _LOCK:
        campaign, cells, seed = _campaign_of(job)
        outcome = run_batch(campaign.trial, cells[cell], cell, seed, numbers)
        rows = _kept(job, campaign, cell, outcome.trials, outcome.rows)
        return Delivery(outcome.trials, rows, outcome.took_s, outcome.failure)


def part_name(cell: int, numbers: Sequence[int]) -> str:
    """Return the name of the part of these trials; the same trials have the same name."""
    digest = hashlib.sha256(repr(tuple(numbers)).encode()).hexdigest()[:8]
    return f"{cell:05}-{numbers[0]:07}-{len(numbers)}-{digest}"


def cells_digest(cells: Sequence[Any]) -> str:
    """Return SHA-256 of the parameters of cells."""
    text = json.dumps([cell_parameters(cell) for cell in cells], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


@lru_cache(maxsize=4)
def _campaign_of(job: Job) -> tuple[AnyCampaign, tuple[Any, ...], int]:
    """Return campaign, cells and seed of a job."""
    campaign = find(job.campaign)
    options = campaign.options.model_validate_json(job.options)
    return campaign, tuple(campaign.cells(options)), options.seed


def _cells_differ(job: Job) -> str:
    _, cells, _ = _campaign_of(job)
    return "" if cells_digest(cells) == job.cells else "the same options make other cells there"


def _kept(
    job: Job, campaign: AnyCampaign, cell: int, numbers: tuple[int, ...], rows: Sequence[Any]
) -> bytes | None:
    """Write rows into the folder, or return them as Parquet if this worker cannot access it."""
    if not rows:
        return None
    folder = CampaignFolder.of(campaign, Path(job.folder))
    frame = pl.DataFrame(rows, schema=folder.schema)
    if folder.manifest_digest() == job.manifest:
        folder.write_part(part_name(cell, numbers), frame)
        return None
    stream = io.BytesIO()
    frame.write_parquet(stream)
    return stream.getvalue()
