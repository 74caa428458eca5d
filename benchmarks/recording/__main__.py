"""``make recording``: run the benchmark and print it; the exit code is 1 where anything was lost.

Each minute a line on standard error says how it goes. Without ``--out`` a file is removed once it is closed
and checked, so that there are never more than two, 7 GB unless ``split_bytes`` is set, however long it runs.
"""

import json
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from recording.benchmark import Load, Result, Sample, measure

_WARM_S = 10.0
"""From then on memory is compared: the queue and the allocator have seen a few syncs and chunks."""
_MEBI = 1 << 20


def main(  # noqa: PLR0917 - typer names its options
    seconds: Annotated[float, typer.Option(min=2.0, help="How long the camera sends.")] = 60.0,
    rate: Annotated[float, typer.Option(min=1.0, help="Frames a second.")] = 45.0,
    raw: Annotated[bool, typer.Option(help="Raw samples beside depth and amplitude.")] = True,
    out: Annotated[Path | None, typer.Option(help="Where the log goes and stays.")] = None,
    setting: Annotated[list[str] | None, typer.Option(help="Of the logger, as 'compression: none'.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one object instead of the table.")] = False,
) -> None:
    """A PMD camera at full rate, through a router, into a logger: loss, processor time and memory."""
    diary = Diary()
    result = measure(Load(seconds, rate, raw), out=out, settings=setting or [], tell=diary.tell)
    figures = _figures(result, seconds) | {
        "RSS MiB at the start, each minute, at the end": diary.rss_mebi,
        "files are": "kept" if out else "removed as they are closed",
    }
    if as_json:
        sys.stdout.write(json.dumps(figures, indent=2) + "\n")
    else:
        table = Table("what", "value", title=f"{rate:g} Hz, {seconds:g} s{', raw samples' if raw else ''}")
        for what, value in figures.items():
            table.add_row(what, str(value))
        Console().print(table)
    raise typer.Exit(0 if figures["complete"] else 1)


class Diary:
    """Says how it goes, a line each time: what was lost so far, the share of a core since the last line."""

    def __init__(self) -> None:
        self.rss_mebi: list[float] = []
        self._before: Sample | None = None

    def tell(self, now: Sample, counters: dict[str, int]) -> None:
        """Print a line."""
        lost = ", ".join(f"{_total(counters, f'{kind}/')} {kind}" for kind in ("recovered", "missed", "lost"))
        self.rss_mebi.append(round(now.rss_bytes / _MEBI, 1))
        line = f"{now.time_s / 60.0:5.1f} min: RSS {self.rss_mebi[-1]} MiB, {lost}"
        if self._before and now.time_s > self._before.time_s:
            line += f", {_share(self._before, now):.3f} of a core"
        self._before = now
        Console(stderr=True, highlight=False).print(line)


def _share(before: Sample, after: Sample) -> float:
    return (after.cpu_s - before.cpu_s) / (after.time_s - before.time_s)


def _figures(result: Result, seconds: float) -> dict[str, object]:
    warm = [sample for sample in result.samples if sample.time_s >= _WARM_S] or list(result.samples)
    rss = np.array([sample.rss_bytes for sample in warm]) / _MEBI
    thirds = [round(float(np.median(part)), 1) for part in np.array_split(rss, 3) if len(part)]
    return {
        "sent MB/s": round(result.sent_bytes / seconds / 1e6, 1),
        "frames sent late": result.late_frames,
        "files": len(result.files),
        "files MB": round(result.file_bytes / 1e6, 1),
        "complete": bool(result.files) and all(said.complete for said in result.files),
        "reasons": [reason for said in result.files for reason in said.reasons],
        "recovered": _total(result.counters, "recovered/"),
        "missed": _total(result.counters, "missed/"),
        "lost": _total(result.counters, "lost/"),
        "share of a core": round(_share(result.samples[0], result.samples[-1]), 3),
        "queue high water MiB": round(result.counters["queue/high_water_bytes"] / _MEBI, 1),
        "RSS MiB, median of each third": thirds,
        "RSS MiB, most": round(float(rss.max()), 1),
    }


def _total(counters: dict[str, int], kind: str) -> int:
    return sum(count for name, count in counters.items() if name.startswith(kind))


typer.run(main)
