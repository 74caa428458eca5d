"""The port of the executors: trials go in, rows come out, in any order."""

from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from rpod_campaign.engine.campaign import AnyCampaign, Row
from rpod_campaign.engine.folder import CampaignFolder
from rpod_campaign.engine.options import Options


class Task(NamedTuple):
    """One trial that is to be run."""

    cell: int
    """Index of the cell."""
    trial: int
    """Number of the trial within the cell."""


class Finished(NamedTuple):
    """Trials of one cell that are done."""

    cell: int
    """Index of the cell."""
    trials: tuple[int, ...]
    """Numbers of the trials."""
    rows: Sequence[Row] | None
    """With cell and trial in front; None if they are in the campaign's folder already."""


@dataclass(frozen=True)
class Work:
    """A campaign as an executor needs it."""

    campaign: AnyCampaign
    options: Options
    cells: tuple[Any, ...]
    """The campaign's cells of these options."""
    targets: Mapping[str, str]
    """Digests of the cells' targets, by name."""
    folder: CampaignFolder

    def place(self, cell: int, trial: int) -> str:
        """Return a trial in words, with what runs it again."""
        return (
            f"{self.campaign.name}, cell {cell} ({self.cells[cell]}), trial {trial}, seed {self.options.seed}"
        )


class Executor(Protocol):
    """Runs trials. An adapter keeps no rows: whoever iterates does, unless ``Finished.rows`` is None."""

    def run(self, work: Work, tasks: Iterable[Task]) -> Generator[Finished]:
        """Yield trials as they finish, each exactly once, until all are done.

        Closing the generator stops what is under way.

        Raises:
            TrialFailedError: a trial raised an exception; those that finished before it were yielded.
            CampaignError: the trials cannot be run any further.
        """
        ...

    def described(self) -> Mapping[str, str]:
        """Return where trials run, by name, for the report."""
        ...
