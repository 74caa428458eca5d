"""``make kills`` and ``make soak``: what a facility under ``rpod up`` stands."""

import os
import signal
import sys
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from endurance.facility import SERVICES, kept_facility
from endurance.kills import Kill, desk
from endurance.soak import figures, slope, watch, write

app = typer.Typer(add_completion=False)
_MEDIAN_S, _MOST_S, _LOST_S = 2.0, 5.0, 1.0
"""Aims: TRACKING again at the median and at most; truth that no log holds."""
_GROWTH_MIB = 0.05
"""Aim: growth of each process's memory, a minute."""


@app.callback()
def endurance() -> None:
    """What a facility under 'rpod up' stands."""
    for number in (signal.SIGTERM, signal.SIGHUP):  # ends what was started, as Ctrl-C does
        signal.signal(number, lambda number, _: sys.exit(128 + number))


@app.command()
def kills(
    count: Annotated[int, typer.Option(min=1, help="Kills of each service.")] = 100,
    service: Annotated[list[str] | None, typer.Option(help="Only this service; may be repeated.")] = None,
    rate: Annotated[float, typer.Option(help="Frames of the camera a second.")] = 20.0,
    seed: Annotated[int, typer.Option(help="Seed of the times between kills.")] = 1,
    reserve: Annotated[bool, typer.Option(help="Services have a process in reserve.")] = False,
) -> None:
    """Kill each service so often, in turn; the exit code is 1 where an aim is missed."""
    rnd, console, done = Random(seed), Console(highlight=False, width=160), dict[str, list[Kill]]()
    with (
        TemporaryDirectory() as folder,
        kept_facility(Path(folder), rate_hz=rate, reserve=reserve) as facility,
        desk(facility, reserve=reserve) as at,
    ):
        for wrong in at.settle():
            console.print(f"before any kill: {wrong}")
        for number in range(1, count + 1):
            for name in service or SERVICES:
                kill = at.kill(name, rnd)
                done.setdefault(name, []).append(kill)
                console.print(
                    f"{number:3} {name:9} TRACKING {kill.tracking_s:.2f} s, at work {kill.ready_s:.2f} s, "
                    f"echo {kill.echo_s:.2f} s, processor {kill.processor_s:.2f} s, lost {kill.lost_s:.3f} s "
                    f"{'; '.join(kill.wrong)}"
                )
            quiet = at.settle()
            for wrong in quiet:
                console.print(f"    a file without a kill: {wrong}")
    console.print(_table(done))
    console.print(f"load average {', '.join(f'{load:.1f}' for load in os.getloadavg())}")
    raise typer.Exit(0 if all(_reached(each) for each in done.values()) else 1)


@app.command()
def soak(
    hours: Annotated[float, typer.Option(min=0.01, help="How long.")] = 1.0,
    rate: Annotated[float, typer.Option(help="Frames of the camera a second.")] = 20.0,
    out: Annotated[Path, typer.Option(help="Folder of soak.html and soak.json.")] = Path("build/soak"),
) -> None:
    """Watch a facility for hours; the exit code is 1 where an aim is missed."""
    console = Console(highlight=False, width=160)
    with (
        TemporaryDirectory() as folder,
        kept_facility(Path(folder), rate_hz=rate, logger={"split_interval_s": 60.0}) as facility,
    ):
        seen = watch(facility, seconds=3600.0 * hours, rate_hz=rate)
    console.print(f"{write(seen, out)}")
    console.print_json(data=figures(seen))
    console.print(f"load average {', '.join(f'{load:.1f}' for load in os.getloadavg())}")
    slopes = [slope(rows, 1) for rows in seen.processes.values()]
    grows = any(each is not None and each.low > _GROWTH_MIB for each in slopes)
    raise typer.Exit(1 if grows or seen.missed or seen.wrong else 0)


def _table(done: dict[str, list[Kill]]) -> Table:
    table = Table(
        "killed", "times", "TRACKING after, s: min, median, p90, most", "at work after, s",
        "bare echo after, s", "processor time, s: most", "log lost, s: most", "completeness right",
    )  # fmt: skip
    for name, found in done.items():
        table.add_row(
            name,
            str(len(found)),
            _spread([kill.tracking_s for kill in found]),
            _spread([kill.ready_s for kill in found]),
            _spread([kill.echo_s for kill in found]),
            f"{max(kill.processor_s for kill in found):.2f}",
            f"{max(kill.lost_s for kill in found):.3f}",
            f"{sum(not kill.wrong for kill in found)} of {len(found)}",
        )
    return table


def _spread(values: list[float]) -> str:
    return ", ".join(f"{value:.2f}" for value in np.quantile(values, [0.0, 0.5, 0.9, 1.0]))


def _reached(found: list[Kill]) -> bool:
    tracking = [kill.tracking_s for kill in found]
    return (
        float(np.median(tracking)) <= _MEDIAN_S
        and max(tracking) <= _MOST_S
        and max(kill.lost_s for kill in found) <= _LOST_S
        and not any(kill.wrong for kill in found)
    )


if __name__ == "__main__":
    app()
