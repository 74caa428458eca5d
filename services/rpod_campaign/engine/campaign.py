"""What a campaign is: its options, its cells, its trial, and how its rows become tables and figures."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Generic, Literal, TypeVar

import polars as pl
from pydantic import Field

from rpod_campaign.engine.numbers import NONE
from rpod_schemas.config.base import Config, Positive
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.errors import ConfigurationError

CellT = TypeVar("CellT")
Row = Mapping[str, Any]
Choices = Annotated[tuple[str, ...], Field(min_length=1)]


class Options(Config):
    """What the command line says of a campaign; what it leaves out is the campaign's own default."""

    trials: Annotated[int, Field(gt=0)] | None = None
    """Of each cell."""
    ranges: Annotated[tuple[Positive, ...], Field(min_length=1)] | None = None
    """Distances of the target's origin, m."""
    steps: Annotated[tuple[Annotated[float, Field(ge=5, le=90)], ...], Field(min_length=1)] | None = None
    """Steps of the template grid, deg."""
    scan_steps: Annotated[tuple[Positive, ...], Field(min_length=1)] | None = None
    """Steps of the scan, deg."""
    method: Choices | None = None
    """Names of methods."""
    target: Choices | None = None
    """Names or files of targets."""
    seed: Annotated[int, Field(ge=0)] = 1
    """Of all randomness."""
    eq4: Literal["usual", "printed", "both"] | None = None
    """Reading of Eq. 4 of the 2015 paper."""
    sampling: Literal["euler", "so3", "both"] | None = None
    """Distribution of the random attitudes."""
    centroid: Literal["plain", "offset", "both"] | None = None
    """Template matching's position: the scan's centroid, or corrected by the template's own offset."""
    matcher: Choices | None = None
    """How the ICP after template matching pairs points."""
    scenario: Choices | None = None
    """Names of scenarios."""
    scenarios: dict[str, Scenario] = Field(default_factory=dict)
    """Those that there are, by name: they ship a layer above, and come with the command."""
    radius: Annotated[tuple[Annotated[int, Field(gt=0)], ...], Field(min_length=1)] | None = None
    """Of the neighbour search of ICP with reverse calibration, pixels."""
    frames: Literal["keyframes", "full", "both"] | None = None
    """Of a sequence: one a second, or as fast as the camera is."""
    through: Literal["tracker", "truth", "navigator", "both"] | None = None
    """Where a frame's first guess comes from: the last estimate, the last true pose, the navigator; both is
    the first and the last of them."""
    depth: Literal["raw", "calibrated", "both"] | None = None
    """With the camera's wiggling error, or with what a calibration leaves of it."""
    case: Choices | None = None
    """Names of a campaign's cases."""

    def both(self, name: str, default: str = "both") -> tuple[str, ...]:
        """Return the readings that an option with ``both`` stands for."""
        readings = {
            "eq4": ("usual", "printed"),
            "sampling": ("euler", "so3"),
            "centroid": ("plain", "offset"),
            "frames": ("keyframes", "full"),
            "through": ("tracker", "navigator"),
            "depth": ("raw", "calibrated"),
        }
        chosen = getattr(self, name) or default
        return readings[name] if chosen == "both" else (chosen,)


@dataclass(frozen=True)
class Table:
    """Cells of text in columns, for a terminal and for a page."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def condensed(self, names: int) -> "Table":
        """Return the table with what is the same in all rows in its title.

        Args:
            names: how many of the first columns may go there.
        """
        shared = [k for k in range(names) if self.rows and len({row[k] for row in self.rows}) == 1]
        kept = [k for k in range(len(self.columns)) if k not in shared]
        about = ", ".join(_said(self.columns[k], self.rows[0][k]) for k in shared if self.rows[0][k] != NONE)
        return Table(
            f"{self.title} ({about})" if about else self.title,
            tuple(self.columns[k] for k in kept),
            tuple(tuple(row[k] for k in kept) for row in self.rows),
        )


def _said(column: str, value: str) -> str:
    """Return a value with its column's name, and the unit where it belongs."""
    name, _, unit = column.partition(", ")
    return f"{name} {value} {unit}".rstrip()


@dataclass(frozen=True)
class Section:
    """A part of the report."""

    title: str
    note: str = ""
    """What the reader has to know of it."""
    tables: tuple[Table, ...] = ()
    figures: tuple[Any, ...] = ()
    """Plotly figures."""


@dataclass(frozen=True)
class CellResult(Generic[CellT]):
    """A cell with all of its rows."""

    cell: CellT
    rows: pl.DataFrame
    """One row a trial, in the order of the trials."""
    summary: Row
    """What ``--json`` prints of it."""


@dataclass(frozen=True)
class Campaign(Generic[CellT]):
    """Named cells times trials. ``trial`` is a function of a module, so that another process can find it."""

    name: str
    title: str
    trials: int
    """Of each cell where ``--trials`` is not given."""
    accepts: frozenset[str]
    """Options that count here, besides trials and seed."""
    cells: Callable[[Options], Sequence[CellT]]
    """Raises ConfigurationError, which names the option."""
    trial: Callable[[CellT, int, int], Row | Sequence[Row]]
    """Of a cell, a seed and a trial's number: a row with exactly the columns of ``schema``, or several."""
    schema: Mapping[str, Any]
    """Columns of a row and their polars types."""
    summarise: Callable[[CellT, pl.DataFrame], Row]
    sections: Callable[[Sequence[CellResult[CellT]]], Sequence[Section]]
    most_trials: int | None = field(default=None)
    """A campaign over a fixed sequence has no more."""
    keys: tuple[str, ...] = ()
    """Columns that tell the rows of one trial apart, where it has several."""

    def require(self, options: Options) -> None:
        """Raise ConfigurationError for an option that has no effect here."""
        given = options.model_fields_set - {"trials", "seed", "scenarios"}
        for name in sorted(given - self.accepts):
            if getattr(options, name) is not None:
                raise ConfigurationError(f"--{name.replace('_', '-')}", "", f"has no meaning for {self.name}")
        if self.most_trials and (options.trials or 0) > self.most_trials:
            raise ConfigurationError("--trials", "", f"{self.name} has {self.most_trials} at most")


AnyCampaign = Campaign[Any]
