"""Plays each fault of a sensor live and tells when the check names it.

``python -m live_check play FOLDER`` plays and keeps all messages, ``python -m live_check judge FOLDER`` asks
the check after 2 s, 4 s and so on, and prints the table.
"""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from live_check.players import SENSORS, Case, bus
from live_check.table import show
from live_check.watching import await_emulator, judged, load, options_of, record, save
from rpod_runtime import Node
from rpod_schemas.config.service import BusConfig, ServiceConfig
from rpod_schemas.faults import FAULTS

_ALONE = {"not_latched"}
"""Faults of a topic that all sensors of an emulator share."""
_RANDOM = {
    "", "lost_frames", "lost_messages", "partial", "local_time", "boot_clock", "clock_ahead", "clock_behind",
    "clock_drift", "stamp_jitter", "dropout", "glints", "second_mount", "not_latched", "mount_off",
}  # fmt: skip
"""Faults that a seed changes, or (not_latched) that were missed once; empty for a sensor in order."""

app = typer.Typer()


@app.command()
def play(
    folder: Annotated[Path, typer.Argument(help="Folder in which all messages are kept.")],
    seeds: Annotated[int, typer.Option(min=1)] = 3,
    duration: Annotated[float, typer.Option(min=2.0, help="Time to watch, s.")] = 20.0,
    at_once: Annotated[int, typer.Option(min=1, help="Sensors on one emulator.")] = 6,
    only: Annotated[list[str] | None, typer.Option(help="Names of faults; good for none.")] = None,
) -> None:
    """Play each fault, and sensors in order; keep what a check would receive."""
    folder.mkdir(parents=True, exist_ok=True)
    for cases in _batches(seeds, at_once, only):
        try:
            _play(cases, duration, folder)
        except TimeoutError as error:
            typer.echo(f"{', '.join(case.name for case in cases)}: {error}", err=True)


@app.command()
def judge(folder: Path) -> None:
    """Ask the check of each recording, and print the table."""
    rows = folder / "rows.jsonl"
    with rows.open("w", encoding="utf-8") as file:
        for path in sorted(folder.glob("*.pickle.gz")):
            case, told = load(path, options_of)
            file.write(json.dumps(judged(case, told)) + "\n")
            file.flush()
    show(rows)


def _batches(seeds: int, at_once: int, only: list[str] | None) -> Iterator[tuple[Case, ...]]:
    for seed in range(seeds):
        for kind in SENSORS:
            names = ["", *(fault.name for fault in FAULTS if fault.can_be_in(kind))]
            chosen = [name for name in names if only is None or (name or "good") in only]
            chosen = [name for name in chosen if not seed or name in _RANDOM]
            alone = [Case(kind, name, seed) for name in chosen if name in _ALONE]
            cases = [Case(kind, name, seed) for name in chosen if name not in _ALONE]
            yield from (tuple(cases[first : first + at_once]) for first in range(0, len(cases), at_once))
            yield from ((case,) for case in alone)


def _play(cases: tuple[Case, ...], duration_s: float, folder: Path) -> None:
    with TemporaryDirectory() as scratch, bus(Path(scratch)) as played:
        played.emulate(cases)
        config = ServiceConfig(instance="waiting", bus=BusConfig(connect=played.endpoint, wait=True))
        with Node(config, version="benchmark") as node:
            await_emulator(node, cases)
        sensors = {case.name: (case.kind, options_of(case)) for case in cases}
        told = record(played.endpoint, sensors, duration_s)
        load_average = os.getloadavg()[0]
    for case in cases:
        save(folder, case, told[case.name], load_average)


app()
