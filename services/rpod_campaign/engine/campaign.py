"""A campaign: its options, its cells, its trial, and the summary of its rows in tables and figures."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Generic, TypeVar

import polars as pl

from rpod_campaign.engine.options import Options
from rpod_campaign.engine.report.content import Section
from rpod_schemas.errors import ConfigurationError

CellT = TypeVar("CellT")
Row = Mapping[str, Any]
CELL, TRIAL = "cell", "trial"
"""Names of the first columns of every row: index of the cell, number of the trial."""


def described(cell: Any) -> dict[str, Any]:
    """Return the parameters of a cell for its summary, without the whole document of its scenario."""
    return {name: value for name, value in asdict(cell).items() if name != "document"}


@dataclass(frozen=True)
class CellResult(Generic[CellT]):
    """A cell with all of its rows."""

    cell: CellT
    rows: pl.DataFrame
    """Rows of all trials, in the order of the trials."""
    summary: Row
    """Object of the cell in the output of ``--json``."""


@dataclass(frozen=True)
class Campaign(Generic[CellT]):
    """Named cells times trials. ``trial`` is a function of a module, so that another process can find it."""

    name: str
    options: type[Options]
    """Model of its options; its ``title`` is the campaign's."""
    cells: Callable[[Any], Sequence[CellT]]
    """Function from options to cells, frozen dataclasses of JSON values. It raises ConfigurationError, which
    names the option."""
    trial: Callable[[CellT, int, int], Row | Sequence[Row]]
    """Function from a cell, a seed and a trial's number to a row with exactly the columns of ``schema``, or
    to several. The same arguments give the same row in any process."""
    schema: Mapping[str, Any]
    """Columns of a row and their polars types."""
    summarise: Callable[[CellT, pl.DataFrame], Row]
    """Function from a cell and its rows to the cell's object in the output of ``--json``."""
    sections: Callable[[Sequence[CellResult[CellT]]], Sequence[Section]]
    """Function from the results of all cells to the sections of the report."""
    totals: Callable[[Sequence[CellResult[CellT]]], Row] | None = None
    """Function that returns the object ``totals`` in the output of ``--json``; None for a campaign whose
    cells have nothing in common."""
    most_trials: int | None = field(default=None)
    """Largest number of trials, for a campaign over a fixed sequence; None for no limit."""
    keys: tuple[str, ...] = ()
    """Columns that distinguish the rows of one trial, if it has several."""

    @property
    def title(self) -> str:
        """Title of the campaign, one line."""
        return self.options.title

    def require(self, options: Options) -> None:
        """Raise ConfigurationError for options that are not this campaign's, or for too many trials."""
        if not isinstance(options, self.options):
            raise ConfigurationError(self.name, "", f"needs {self.options.__module__}.Options")
        if self.most_trials and options.trials > self.most_trials:
            reason = f"is {options.trials}; {self.name} has {self.most_trials} at most"
            raise ConfigurationError("--trials", "", reason)


AnyCampaign = Campaign[Any]
