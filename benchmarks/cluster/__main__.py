"""``make cluster``: the same campaign on the process pool and on a Dask cluster, in pairs.

Each run has a folder of its own; the order changes from pair to pair. A time goes from before the processes
are started to after the last row is kept.
"""

import statistics
import tempfile
import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from rpod_campaign.engine.executor import Executor
from rpod_campaign.engine.executor.cluster import Cluster
from rpod_campaign.engine.executor.pool import ProcessPool
from rpod_campaign.engine.run import prepare, run_campaign
from rpod_campaign.lidar_acquisition.campaign import CAMPAIGN
from rpod_campaign.lidar_acquisition.options import Options


def main(
    workers: Annotated[int, typer.Option(min=1, help="Number of processes of either.")] = 2,
    pairs: Annotated[int, typer.Option(min=1)] = 5,
    trials: Annotated[int, typer.Option(min=1, help="Number of trials of each of two cells.")] = 200,
    address: Annotated[
        str | None, typer.Option(help="Scheduler whose workers run already; local:N if not given.")
    ] = None,
) -> None:
    """Print the times of each pair, and the median of their ratios."""
    executors: dict[str, Executor] = {
        "pool": ProcessPool(workers),
        "cluster": Cluster(address or f"local:{workers}"),
    }
    ratios = []
    for pair in range(pairs):
        order = ("pool", "cluster") if pair % 2 == 0 else ("cluster", "pool")
        took_s = {name: _time_s(executors[name], trials) for name in order}
        ratios.append(took_s["cluster"] / took_s["pool"])
        Console().print(
            f"pool {took_s['pool']:.1f} s, cluster {took_s['cluster']:.1f} s, ratio {ratios[-1]:.3f}"
        )
    Console().print(f"median ratio {statistics.median(ratios):.3f}, {min(ratios):.3f} to {max(ratios):.3f}")


def _time_s(executor: Executor, trials: int) -> float:
    options = Options(method=("global",), ranges=(20.0, 50.0), trials=trials, seed=7)
    with tempfile.TemporaryDirectory() as folder:
        prepared = prepare(CAMPAIGN, options, out=Path(folder), version="benchmark")
        begin_s = time.perf_counter()
        run_campaign(prepared, executor)
        return time.perf_counter() - begin_s


if __name__ == "__main__":
    typer.run(main)
