"""``make peers``: run the benchmark and print it."""

import json
import os
import sys
from dataclasses import asdict
from importlib.metadata import version
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress

from peers.benchmark import Peer, Scene, Score, Task, cases, run, score
from peers.catalogue import PEERS
from peers.own import finish
from peers.table import table
from rpod_schemas.config.lidar import LidarConfig
from rpod_target import load_target

WIDTH = 140
"""Of the table where it is not printed on a terminal."""


def main(  # noqa: PLR0917 - typer names its options
    trials: Annotated[int, typer.Option(min=1, help="Scans at each range.")] = 100,
    ranges: Annotated[str, typer.Option(help="Ranges in m, with commas.")] = "20,50",
    seed: Annotated[int, typer.Option(min=0, help="Of attitudes, noise and starts; 1 was for tuning.")] = 7,
    target: Annotated[str, typer.Option(help="Name or file of the target.")] = "envisat-bulky",
    only: Annotated[str, typer.Option(help="Peers whose name holds this.")] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print one object instead of the table.")] = False,
) -> None:
    """Registration packages and our own methods on the same LIDAR scans, one thread each."""
    _use_one_core()
    lidar = LidarConfig()
    scenes = [Scene(load_target(target), lidar, float(range_m)) for range_m in ranges.split(",")]
    peers = [peer for peer in PEERS if only in peer.name]
    scores = _scores(peers, scenes, seed=seed, trials=trials)
    if as_json:
        sys.stdout.write(json.dumps(_document(peers, scores, target=target, seed=seed), indent=2) + "\n")
        return
    console = Console(width=None if Console().is_terminal else WIDTH)
    console.print(table(scores, title=f"{target}, {trials} scans at each range, seed {seed}"))
    for peer in peers:
        console.print(f"{peer.task}, {peer.package} {peer.name}: {peer.setup}", style="dim")


def _use_one_core() -> None:
    """Stay on one core: not every package says how many threads it takes."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


def _scores(peers: list[Peer], scenes: list[Scene], *, seed: int, trials: int) -> list[Score]:
    scores = []
    with Progress(console=Console(stderr=True)) as progress:
        bar = progress.add_task("peers", total=len(peers) * len(scenes))
        for scene in scenes:
            drawn = list(cases(scene, seed=seed, trials=trials))
            last = finish(scene)
            for peer in peers:
                progress.update(bar, description=f"{peer.name}, {scene.range_m:g} m")
                refine = last if peer.task is Task.ACQUISITION else None
                scores.append(score(peer, scene.range_m, run(peer.build(scene), drawn, finish=refine)))
                progress.advance(bar)
    order = [(peer.task, peer.package, peer.name) for peer in peers]
    return sorted(scores, key=lambda each: (order.index((each.task, each.package, each.peer)), each.range_m))


def _document(peers: list[Peer], scores: list[Score], *, target: str, seed: int) -> dict[str, object]:
    return {
        "target": target,
        "seed": seed,
        "packages": {name: version(name) for name in sorted({peer.package for peer in peers})},
        "setups": {f"{peer.task}, {peer.package}, {peer.name}": peer.setup for peer in peers},
        "scores": [asdict(each) for each in scores],
    }


if __name__ == "__main__":
    typer.run(main)
