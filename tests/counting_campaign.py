"""A campaign whose trials cost nothing, in a module of its own so that another process finds it."""

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import polars as pl

from rpod_campaign.engine import Campaign, Options, Ranges, Section, Trials


@dataclass(frozen=True)
class CountingCell:
    factor: float
    pause_s: float = 0.0


class CountingOptions(Options):
    """Counting."""

    title: ClassVar[str] = "Counting"

    trials: Trials = 5
    ranges: Ranges = (1.0, 2.0)
    pause: float = 0.0
    """Time that a trial takes, s."""


def cells(options: CountingOptions) -> list[CountingCell]:
    return [CountingCell(factor, options.pause) for factor in options.ranges]


class TwoPartsError(Exception):
    """Cannot be pickled: its arguments are not those of its message."""

    def __init__(self, file: str, reason: str) -> None:
        super().__init__(f"{file}: {reason}")


def trial(cell: CountingCell, seed: int, number: int) -> dict[str, Any]:
    if cell.factor == 99.0:
        os.kill(os.getpid(), signal.SIGKILL)
    if cell.factor == 98.0:
        os.kill(os.getpid(), signal.SIGSEGV)
    if cell.factor == 97.0:
        os._exit(3)
    time.sleep(cell.pause_s)
    if "COUNTING_LOG" in os.environ:
        with Path(os.environ["COUNTING_LOG"]).open("a") as log:
            log.write(f"{cell.factor:g} {number}\n")
    if cell.factor == 14.0:
        raise TwoPartsError("mesh", "has no triangles")
    if cell.factor == 13.0:
        raise ArithmeticError("unlucky")
    return {"value": cell.factor * float(np.random.default_rng((seed, number)).random())}


def summarise(cell: CountingCell, rows: pl.DataFrame) -> dict[str, Any]:
    return {"factor": cell.factor, "trials": rows.height, "mean": rows["value"].mean()}


CAMPAIGN: Campaign[CountingCell] = Campaign(
    name="counting",
    options=CountingOptions,
    cells=cells,
    trial=trial,
    schema={"value": pl.Float64},
    summarise=summarise,
    sections=lambda results: [Section(f"{len(results)} cells")],
)
