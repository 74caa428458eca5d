"""What a campaign is: its options, its cells, its trial, and how its rows become tables and figures."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import polars as pl

from rpod_campaign.engine.options import Options
from rpod_campaign.engine.report.content import Section
from rpod_schemas.errors import ConfigurationError

CellT = TypeVar("CellT")
Row = Mapping[str, Any]
CELL, TRIAL = "cell", "trial"
"""Columns in front of every row: index of the cell, number of the trial."""


@dataclass(frozen=True)
class CellResult(Generic[CellT]):
    """A cell with all of its rows."""

    cell: CellT
    rows: pl.DataFrame
    """One row a trial, in the order of the trials."""
    summary: Row
    """The cell's object in the output of ``--json``."""


@dataclass(frozen=True)
class Campaign(Generic[CellT]):
    """Named cells times trials. ``trial`` is a function of a module, so that another process can find it."""

    name: str
    options: type[Options]
    """The model of its options; its ``title`` is the campaign's."""
    cells: Callable[[Any], Sequence[CellT]]
    """Returns the cells of options, frozen dataclasses of JSON values. Raises ConfigurationError, which names
    the option."""
    trial: Callable[[CellT, int, int], Row | Sequence[Row]]
    """Takes a cell, a seed and a trial's number; returns a row with exactly the columns of ``schema``, or
    several. The same arguments give the same row, whoever calls."""
    schema: Mapping[str, Any]
    """Columns of a row and their polars types."""
    summarise: Callable[[CellT, pl.DataFrame], Row]
    sections: Callable[[Sequence[CellResult[CellT]]], Sequence[Section]]
    most_trials: int | None = field(default=None)
    """A campaign over a fixed sequence has no more."""
    keys: tuple[str, ...] = ()
    """Columns that tell the rows of one trial apart, where it has several."""

    @property
    def title(self) -> str:
        """What the campaign tries, in one line."""
        return self.options.title

    def require(self, options: Options) -> None:
        """Raise ConfigurationError for options that are not this campaign's, or for too many trials."""
        if not isinstance(options, self.options):
            raise ConfigurationError(self.name, "", f"needs {self.options.__module__}.Options")
        if self.most_trials and options.trials > self.most_trials:
            raise ConfigurationError("--trials", "", f"{self.name} has {self.most_trials} at most")


AnyCampaign = Campaign[Any]
