"""The progress of a campaign on standard error."""

import time
from collections import Counter, defaultdict
from collections.abc import Callable

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
)

from rpod_campaign.engine.run import Prepared

_PERIOD_S, _JSON_PERIOD_S = 10.0, 60.0
"""Least time between two lines, s, without and with ``--json``; a line comes when a trial has ended."""


class CampaignProgress:
    """Shows a bar on a terminal, else lines: one in ten seconds at most, with ``--json`` in a minute."""

    def __init__(self, prepared: Prepared, *, as_json: bool) -> None:
        self._prepared, self._quiet = prepared, as_json
        self._console = Console(markup=False, stderr=True)
        self._period_s = _JSON_PERIOD_S if as_json else _PERIOD_S
        self._said_s = time.monotonic()
        self._pace = _Pace(prepared, self._said_s)
        self._bar: Progress | None = None
        self._show: Callable[[], None] = self._print_plain

    def __enter__(self) -> "CampaignProgress":
        self.note(_beginning(self._prepared))
        if self._console.is_terminal and not self._quiet:
            self._bar = bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeElapsedColumn(),
                TextColumn("{task.fields[left]}"),
                console=self._console,
                transient=True,
            )
            bar.start()
            name, total = self._prepared.campaign.name, self._prepared.total
            task = bar.add_task(name, total=total, completed=self._pace.done, left="")
            self._show = lambda: bar.update(task, completed=self._pace.done, left=self._pace.left())
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar:
            self._bar.stop()

    def one(self, cell: int) -> None:
        """Count a trial of a cell."""
        self._pace.one(cell, time.monotonic())
        self._show()

    def note(self, text: str) -> None:
        """Show a line about the campaign or its workers, but not with ``--json``."""
        if not self._quiet:
            self._console.print(text, soft_wrap=True, highlight=False)

    def _print_plain(self) -> None:
        now_s = time.monotonic()
        if now_s - self._said_s >= self._period_s:
            self._said_s = now_s
            text = f"{self._pace.done} of {self._prepared.total} trials, {self._pace.left()}"
            self._console.print(text, soft_wrap=True, highlight=False)


class _Pace:
    """How long the trials of each cell take in this run.

    Those of one cell may take a hundred times as long as those of another.
    """

    def __init__(self, prepared: Prepared, begin_s: float) -> None:
        self.done = len(prepared.done)
        """Number of finished trials."""
        self._left = Counter(task.cell for task in prepared.tasks())
        self._ended, self._took_s = Counter[int](), defaultdict[int, float](float)
        self._last_s = begin_s

    def one(self, cell: int, now_s: float) -> None:
        """Count a trial of a cell, which took the time since the last one."""
        self.done += 1
        self._left[cell] -= 1
        self._ended[cell] += 1
        self._took_s[cell] += now_s - self._last_s
        self._last_s = now_s

    def left(self) -> str:
        """Return how long the remaining trials take, in words.

        Until a trial of a cell has ended, its trials count with the mean of all.
        """
        mean_s = sum(self._took_s.values()) / self._ended.total()
        each_s = {cell: self._took_s[cell] / self._ended[cell] for cell in self._ended}
        left_s = sum(count * each_s.get(cell, mean_s) for cell, count in self._left.items())
        return f"{left_s / 60.0:.1f} min left" if left_s < 6000.0 else f"{left_s / 3600.0:.1f} h left"


def _beginning(prepared: Prepared) -> str:
    """Return the first line: that the campaign resumes, or that it starts and why it does not resume."""
    path = prepared.folder.path
    if prepared.done:
        return f"resuming {path}: {len(prepared.done)} of {prepared.total} trials are done"
    other = prepared.folder.most_alike()
    because = f"; the campaign in {other[0].name} differs in {', '.join(other[1])}" if other else ""
    return f"starting {path}{because}"
