"""``make busy``: ``rpod run`` beside busy processes; the exit code is 1 where a message was missed."""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer
from rich.console import Console

from rpod_schemas.summary import Summary

_BUSY = (sys.executable, "-c", "while True: pass")


def main(
    scenario: Annotated[str, typer.Argument()] = "mockup-tumbling",
    busy: Annotated[int, typer.Option(min=0, help="Busy processes beside it.")] = 2,
    runs: Annotated[int, typer.Option(min=1)] = 3,
    duration: Annotated[float, typer.Option(min=1.0, help="Of each, s.")] = 20.0,
) -> None:
    """Print how many messages the log of each run missed, and how many frames the estimator passed over."""
    missed = 0
    for number in range(1, runs + 1):
        with TemporaryDirectory() as folder, _busy_processes(busy):
            summary = _run(scenario, duration, Path(folder))
        lost = {topic: count.missed for topic, count in summary.frames.items() if count.missed}
        missed += sum(lost.values())
        Console().print(
            f"{number}: {sum(count.logged for count in summary.frames.values())} messages, "
            f"missed {lost or 0}, frames passed over by the estimator {summary.estimates.dropped}"
        )
    raise typer.Exit(1 if missed else 0)


def _run(scenario: str, duration_s: float, folder: Path) -> Summary:
    command = [sys.executable, "-m", "rpod", "run", scenario]
    options = ["--duration", str(duration_s), "--out", str(folder), "--json"]
    done = subprocess.run(command + options, check=True, stdout=subprocess.PIPE)
    return Summary.model_validate(json.loads(done.stdout))


@contextmanager
def _busy_processes(count: int) -> Iterator[None]:
    processes = [subprocess.Popen(_BUSY) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


typer.run(main)
