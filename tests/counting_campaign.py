"""A campaign whose trials cost nothing, in a module of its own so that another process finds it."""

import os
import signal
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from rpod_campaign.engine import Campaign, Options, Section


@dataclass(frozen=True)
class CountingCell:
    factor: float


def cells(options: Options) -> list[CountingCell]:
    return [CountingCell(factor) for factor in options.ranges or (1.0, 2.0)]


def trial(cell: CountingCell, seed: int, number: int) -> dict[str, Any]:
    if cell.factor == 99.0:
        os.kill(os.getpid(), signal.SIGKILL)
    if cell.factor == 13.0:
        raise ArithmeticError("unlucky")
    return {"value": cell.factor * float(np.random.default_rng((seed, number)).random())}


def summarise(cell: CountingCell, rows: pl.DataFrame) -> dict[str, Any]:
    return {"factor": cell.factor, "trials": rows.height, "mean": rows["value"].mean()}


CAMPAIGN: Campaign[CountingCell] = Campaign(
    name="counting",
    title="Counting",
    trials=5,
    accepts=frozenset({"ranges"}),
    cells=cells,
    trial=trial,
    schema={"value": pl.Float64},
    summarise=summarise,
    sections=lambda results: [Section(f"{len(results)} cells")],
)
