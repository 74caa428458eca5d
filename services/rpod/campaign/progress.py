"""The progress of a campaign on standard error."""

import time
from collections.abc import Callable

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from rpod_campaign.engine.run import Prepared

_PLAIN_PERIOD_S = 10.0
_SPEED_PERIOD_S = 600.0
"""Time over which the speed of the trials is averaged to predict the time left, s. It is long because a trial
of one cell may take a hundred times as long as one of another cell."""


class CampaignProgress:
    """Shows a bar on a terminal, a line every ten seconds elsewhere, and nothing if it is quiet."""

    def __init__(self, prepared: Prepared, *, quiet: bool) -> None:
        self._prepared, self._done = prepared, len(prepared.done)
        self._resumed = self._done
        self._console = Console(markup=False, stderr=True, quiet=quiet)
        self._begin_s = self._said_s = time.monotonic()
        self._bar: Progress | None = None
        self._show: Callable[[], None] = self._print_plain

    def __enter__(self) -> "CampaignProgress":
        prepared = self._prepared
        self._console.print(_beginning(prepared), soft_wrap=True, highlight=False)
        if self._console.is_terminal and not self._console.quiet:
            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeElapsedColumn(),
                TimeRemainingColumn(),
                console=self._console,
                transient=True,
                speed_estimate_period=_SPEED_PERIOD_S,
            )
            self._bar.start()
            bar = self._bar
            task = bar.add_task(prepared.campaign.name, total=prepared.total, completed=self._done)
            self._show = lambda: bar.update(task, completed=self._done)
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar:
            self._bar.stop()

    def one(self, _: int) -> None:
        """Count a trial."""
        self._done += 1
        self._show()

    def note(self, text: str) -> None:
        """Show a line about the workers."""
        self._console.print(text, soft_wrap=True, highlight=False)

    def _print_plain(self) -> None:
        now_s, total = time.monotonic(), self._prepared.total
        if now_s - self._said_s < _PLAIN_PERIOD_S:
            return
        self._said_s = now_s
        each_s = (now_s - self._begin_s) / (self._done - self._resumed)
        left_min = each_s * (total - self._done) / 60.0
        self._console.print(f"{self._done} of {total} trials, {left_min:.1f} min left", highlight=False)


def _beginning(prepared: Prepared) -> str:
    """Return the first line: that the campaign resumes, or that it starts and why it does not resume."""
    path = prepared.folder.path
    if prepared.done:
        return f"resuming {path}: {len(prepared.done)} of {prepared.total} trials are done"
    other = prepared.folder.most_alike()
    because = f"; the campaign in {other[0].name} differs in {', '.join(other[1])}" if other else ""
    return f"starting {path}{because}"
