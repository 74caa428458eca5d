"""Run of a campaign, from its options to its results."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl

from rpod_campaign.engine.campaign import CELL, TRIAL, AnyCampaign, CellResult, Row
from rpod_campaign.engine.executor.port import Executor, Task, Work
from rpod_campaign.engine.folder import CampaignFolder, cell_parameters
from rpod_campaign.engine.options import Options
from rpod_campaign.engine.software import software_digest
from rpod_campaign.engine.trial.targets import cached_target

_FLUSH_ROWS, _FLUSH_S = 500, 5.0
"""Number of rows, and age in s, at which a batch is stored."""


@dataclass(frozen=True)
class Prepared:
    """A campaign with its cells and its folder, ready to run or to resume."""

    work: Work
    done: tuple[tuple[int, int], ...]
    """Cell and trial of the stored trials that are part of this run."""

    @property
    def campaign(self) -> AnyCampaign:
        """Campaign to run."""
        return self.work.campaign

    @property
    def cells(self) -> tuple[Any, ...]:
        """Cells of the campaign with these options."""
        return self.work.cells

    @property
    def trials(self) -> int:
        """Number of trials of each cell."""
        return self.work.options.trials

    @property
    def seed(self) -> int:
        """Seed of all random numbers."""
        return self.work.options.seed

    @property
    def folder(self) -> CampaignFolder:
        """Folder in which the trials are stored."""
        return self.work.folder

    @property
    def total(self) -> int:
        """Number of trials of all cells."""
        return len(self.cells) * self.trials

    def tasks(self) -> Iterator[Task]:
        """Yield the trials that remain to be run.

        First comes one of each cell, so that their time is soon known; the others follow cell by cell.
        """
        done, trials = set(self.done), range(self.trials)
        cells = [
            [Task(cell, trial) for trial in trials if (cell, trial) not in done]
            for cell in range(len(self.cells))
        ]
        for part in (slice(1), slice(1, None)):
            for tasks in cells:
                yield from tasks[part]


def prepare(campaign: AnyCampaign, options: Options, *, out: Path, version: str) -> Prepared:
    """Check the options, build the targets, and open the campaign's folder.

    The number of trials does not change the folder's name: more trials are added to the stored ones.

    Raises:
        ConfigurationError: an option is wrong; the text names it and the reason.
        rpod_target.TargetError: a target cannot be built.
        CampaignError, OSError: the folder cannot be used.
    """
    campaign.require(options)
    cells = tuple(campaign.cells(options))
    targets = {name: cached_target(name).digest for name in _targets(cells)}
    manifest = {
        "campaign": campaign.name,
        "version": version,
        "software": software_digest(campaign),
        "targets": targets,
        "seed": options.seed,
        "cells": [cell_parameters(cell) for cell in cells],
    }
    folder = CampaignFolder.open(out, manifest, campaign.schema, keys=campaign.keys)
    there = folder.read().filter(pl.col(TRIAL) < options.trials).select(CELL, TRIAL).unique().rows()
    return Prepared(Work(campaign, options, cells, targets, folder), tuple(there))


def run_campaign(
    prepared: Prepared, executor: Executor, *, on_trial: Callable[[int], object] = lambda _: None
) -> list[CellResult[Any]]:
    """Run the remaining trials and return the results of all cells.

    If the run ends early for any reason, the finished trials are in the folder.

    Args:
        prepared: the campaign and its folder.
        executor: where the trials run.
        on_trial: called for each finished trial with the index of its cell.
    """
    folder, batch, kept_s = prepared.folder, list[Row](), -math.inf
    try:
        with closing(executor.run(prepared.work, prepared.tasks())) as finished:
            for cell, trials, rows in finished:
                batch += rows or ()
                for _ in trials:
                    on_trial(cell)
                if len(batch) >= _FLUSH_ROWS or time.monotonic() - kept_s > _FLUSH_S:
                    folder.add(batch)
                    folder.compact()
                    batch, kept_s = [], time.monotonic()
    finally:
        folder.add(batch)
    return results(prepared, folder.close())


def results(prepared: Prepared, rows: pl.DataFrame) -> list[CellResult[Any]]:
    """Return each cell with its rows and its summary."""
    counted = rows.filter(pl.col(TRIAL) < prepared.trials)
    campaign = prepared.campaign
    found = []
    for index, cell in enumerate(prepared.cells):
        mine = counted.filter(pl.col(CELL) == index).sort(TRIAL, *campaign.keys)
        found.append(CellResult(cell, mine, campaign.summarise(cell, mine)))
    return found


def _targets(cells: tuple[Any, ...]) -> list[str]:
    """Return the names of the targets in the cells' fields ``target``, ``*_target`` and ``model``."""
    names = {
        value
        for cell in cells
        for field, value in cell_parameters(cell).items()
        if (field in ("target", "model") or field.endswith("_target")) and value
    }
    return sorted(names)
