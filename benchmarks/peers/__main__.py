"""``make peers``: run the benchmark and print it."""

import json
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress

from peers.benchmark import START_DEG, START_M, Peer, Scene, Score, Task, cases, run, score, start_of
from peers.camera import PMD, STARTS, CameraScene, camera_cases
from peers.camera_catalogue import CAMERA_PEERS
from peers.catalogue import PEERS
from peers.own import finish
from peers.table import table
from rpod_schemas.config.lidar import LidarConfig
from rpod_target import load_target

WIDTH = 160
"""Width of the table where it is not printed on a terminal."""
_MOCKUP = "mockup"
"""What the camera looks at."""
Described = Sequence[Peer[Any, Any]]
Results = tuple[Described, list[Score]]


def main(  # noqa: PLR0917 - typer names its options
    clouds: Annotated[str, typer.Option(help="lidar or pmd.")] = "lidar",
    trials: Annotated[int, typer.Option(min=1, help="Scans at each range, or frames.")] = 100,
    ranges: Annotated[str, typer.Option(help="Of the LIDAR's scans, in m, with commas.")] = "20,50",
    seed: Annotated[int, typer.Option(min=0, help="Of attitudes, noise and starts; 1 was for tuning.")] = 7,
    target: Annotated[str, typer.Option(help="Of the LIDAR's scans: name or file.")] = "envisat-bulky",
    only: Annotated[str, typer.Option(help="Peers whose name holds this.")] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print one object instead of the table.")] = False,
) -> None:
    """Registration packages and our own methods on the same LIDAR scans or camera frames, one thread each."""
    _use_one_core()
    if clouds == PMD.name:
        target, what = _MOCKUP, f"the same {trials} frames from each start"
        peers, scores = _in_frames(only, seed=seed, trials=trials)
    else:
        what = f"{trials} scans at each range"
        scenes = [Scene(load_target(target), LidarConfig(), float(range_m)) for range_m in ranges.split(",")]
        peers, scores = _in_scans(only, scenes, seed=seed, trials=trials)
    if as_json:
        sys.stdout.write(json.dumps(_document(peers, scores, target=target, seed=seed), indent=2) + "\n")
        return
    console = Console(width=None if Console().is_terminal else WIDTH)
    console.print(table(scores, title=f"{target}, {what}, seed {seed}"))
    for peer in peers:
        console.print(f"{peer.task}, {peer.package} {peer.name}: {peer.setup}", style="dim")


def _use_one_core() -> None:
    """Stay on one core: not every package says how many threads it takes."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


def _in_scans(only: str, scenes: list[Scene], *, seed: int, trials: int) -> Results:
    peers, scores = [peer for peer in PEERS if only in peer.name], []
    with Progress(console=Console(stderr=True)) as progress:
        bar = progress.add_task("peers", total=len(peers) * len(scenes))
        for scene in scenes:
            drawn = list(cases(scene, seed=seed, trials=trials))
            last = finish(scene)
            for peer in peers:
                progress.update(bar, description=f"{peer.name}, {scene.range_m:g} m")
                refine = last if peer.task is Task.ACQUISITION else None
                start = start_of(START_DEG, START_M) if peer.task is Task.TRACKING else ""
                outcomes = run(peer.build(scene), drawn, finish=refine)
                scores.append(score(peer, outcomes, range_m=scene.range_m, start=start))
                progress.advance(bar)
    order = [(peer.task, peer.package, peer.name) for peer in peers]
    scores.sort(key=lambda each: (order.index((each.task, each.package, each.peer)), each.range_m or 0.0))
    return peers, scores


def _in_frames(only: str, *, seed: int, trials: int) -> Results:
    peers, scores = [peer for peer in CAMERA_PEERS if only in peer.name], []
    scenes = [CameraScene(load_target(_MOCKUP), *start) for start in STARTS]
    drawn = {scene: list(camera_cases(scene, seed=seed, trials=trials)) for scene in scenes}
    with Progress(console=Console(stderr=True)) as progress:
        bar = progress.add_task("peers", total=len(peers) * len(scenes))
        for peer in peers:
            for scene in scenes:
                start = start_of(scene.angle_deg, scene.distance_m)
                progress.update(bar, description=f"{peer.name}, {start}")
                outcomes = run(peer.build(scene), drawn[scene], finish=None)
                scores.append(score(peer, outcomes, clouds=PMD, start=start))
                progress.advance(bar)
    return peers, scores


def _document(peers: Described, scores: list[Score], *, target: str, seed: int) -> dict[str, object]:
    return {
        "target": target,
        "seed": seed,
        "packages": {name: version(name) for name in sorted({peer.package for peer in peers})},
        "setups": {f"{peer.task}, {peer.package}, {peer.name}": peer.setup for peer in peers},
        "scores": [asdict(each) for each in scores],
    }


if __name__ == "__main__":
    typer.run(main)
