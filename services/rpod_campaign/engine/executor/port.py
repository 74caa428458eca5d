"""The port of the executors: they receive trials and return rows, in any order."""

from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from rpod_campaign.engine.campaign import AnyCampaign, Row
from rpod_campaign.engine.folder import CampaignFolder
from rpod_campaign.engine.options import Options


class Task(NamedTuple):
    """One trial to run."""

    cell: int
    """Index of the cell."""
    trial: int
    """Number of the trial within the cell."""


class Finished(NamedTuple):
    """Finished trials of one cell."""

    cell: int
    """Index of the cell."""
    trials: tuple[int, ...]
    """Numbers of the trials."""
    rows: Sequence[Row] | None
    """Rows with cell and trial first; None if they are in the campaign's folder already."""


@dataclass(frozen=True)
class Work:
    """Data of a campaign for an executor."""

    campaign: AnyCampaign
    options: Options
    cells: tuple[Any, ...]
    """Cells of the campaign with these options."""
    targets: Mapping[str, str]
    """Digests of the cells' targets, by name."""
    folder: CampaignFolder

    def place(self, cell: int, trial: int) -> str:
        """Return the description of a trial, with all that is needed to run it again."""
        return (
            f"{self.campaign.name}, cell {cell} ({self.cells[cell]}), trial {trial}, seed {self.options.seed}"
        )


class Executor(Protocol):
    """Runs trials. It does not store rows, which its caller does, unless ``Finished.rows`` is None."""

    def run(self, work: Work, tasks: Iterable[Task]) -> Generator[Finished]:
        """Yield trials as they finish, each exactly once, until all are done.

        Closing the generator stops the running trials.

        Raises:
            TrialFailedError: a trial raised an exception; the trials that finished before were yielded.
            CampaignError: the trials cannot be run any further.
        """
        ...

    def described(self) -> Mapping[str, str]:
        """Return where trials run, by name, for the report."""
        ...
