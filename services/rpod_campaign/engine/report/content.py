"""The parts of a report: sections, tables of text, figures."""

from dataclasses import dataclass
from typing import Any

from rpod_campaign.engine.report.numbers import NONE


@dataclass(frozen=True)
class Table:
    """Cells of text in columns, for a terminal and for a page."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def condensed(self, names: int) -> "Table":
        """Return the table with columns of equal values moved into its title, without empty columns.

        Args:
            names: number of first columns that may move there.
        """
        shared = [k for k in range(names) if self.rows and len({row[k] for row in self.rows}) == 1]
        empty = [k for k in range(names, len(self.columns)) if {row[k] for row in self.rows} <= {"", NONE}]
        kept = [k for k in range(len(self.columns)) if k not in (*shared, *(empty if self.rows else ()))]
        about = ", ".join(
            _with_unit(self.columns[k], self.rows[0][k]) for k in shared if self.rows[0][k] != NONE
        )
        return Table(
            f"{self.title} ({about})" if about else self.title,
            tuple(self.columns[k] for k in kept),
            tuple(tuple(row[k] for k in kept) for row in self.rows),
        )


def _with_unit(column: str, value: str) -> str:
    """Return a value with its column's name and unit."""
    name, _, unit = column.partition(", ")
    return f"{name} {value} {unit}".rstrip()


@dataclass(frozen=True)
class Section:
    """A section of the report."""

    title: str
    note: str = ""
    """Explanation for the reader."""
    tables: tuple[Table, ...] = ()
    figures: tuple[Any, ...] = ()
    """Plotly figures."""
