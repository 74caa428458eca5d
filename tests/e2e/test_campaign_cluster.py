"""Campaigns on a Dask cluster: a real scheduler and real workers, which are killed."""

import os
import random
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest
from counting_campaign import CAMPAIGN, CountingOptions
from dask_processes import DaskProcesses, end, install_counting
from distributed import Client

from rpod import __version__
from rpod_campaign.catalogue import find
from rpod_campaign.engine.errors import NoSchedulerError, NoWorkersError, TrialFailedError, WorkerDiedError
from rpod_campaign.engine.executor import cluster as cluster_module
from rpod_campaign.engine.executor.cluster import Cluster
from rpod_campaign.engine.executor.pool import ProcessPool
from rpod_campaign.engine.run import Prepared, prepare, run_campaign

pytestmark = pytest.mark.timeout(300)
TIMES = ("acquire_s", "icp_s")


def counting(out: Path, **options) -> Prepared:
    return prepare(CAMPAIGN, CountingOptions(**options), out=out, version="1")


def rows_of(results) -> pl.DataFrame:
    rows = pl.concat([result.rows for result in results])
    return rows.drop(column for column in TIMES if column in rows.columns)


def once(campaign: Prepared) -> bool:
    """Return whether the folder has each trial exactly once, in one file, and no part beside it.

    A worker that was killed while it wrote a part leaves a temporary file, which a later run removes.
    """
    rows = pl.read_parquet(campaign.folder.trials_file)
    left = list(campaign.folder.path.glob("part-*.parquet"))
    return rows.height == campaign.total == rows.select("cell", "trial").n_unique() and not left


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Return where the counting campaign is installed; this process finds it too."""
    folder = install_counting(tmp_path_factory.mktemp("counting"))
    sys.path.insert(0, str(folder))
    yield folder
    sys.path.remove(str(folder))


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory, site):
    with DaskProcesses(tmp_path_factory.mktemp("scheduler"), site) as processes:
        yield processes


@pytest.fixture
def dask(scheduler):
    """Return a scheduler to which a test adds workers of its own."""
    yield scheduler
    for name in list(scheduler.workers):
        scheduler.kill_worker(name)


@pytest.fixture(scope="module")
def worker(tmp_path_factory, site):
    """Return a scheduler with one worker, for tests that leave both as they are."""
    with DaskProcesses(tmp_path_factory.mktemp("worker"), site) as processes:
        processes.start_worker("a")
        yield processes


@pytest.mark.usefixtures("site")
def test_another_packages_campaign_is_in_the_catalogue():
    assert find("counting") is CAMPAIGN


def test_pool_one_worker_and_eight_give_the_same_rows(tmp_path, dask):
    options = {"trials": 300, "ranges": (1.0, 2.0, 3.0)}
    pool = rows_of(run_campaign(counting(tmp_path / "pool", **options), ProcessPool(2)))
    dask.start_worker("first")
    one = counting(tmp_path / "one", **options)
    assert rows_of(run_campaign(one, Cluster(dask.address))).equals(pool)
    for number in range(7):
        dask.start_worker(f"worker-{number}")
    with Client(dask.address) as client:
        client.wait_for_workers(8, timeout=120.0)
    eight = counting(tmp_path / "eight", **options)
    assert rows_of(run_campaign(eight, Cluster(dask.address))).equals(pool)
    assert once(one)
    assert once(eight)


def test_killed_workers_and_a_restarted_scheduler_cost_no_row_and_make_none_twice(tmp_path, dask):
    options = {"trials": 80, "ranges": (1.0, 2.0), "pause": 0.05}
    expected = rows_of(run_campaign(counting(tmp_path / "pool", trials=80), ProcessPool(1)))
    for name in ("a", "b"):
        dask.start_worker(name)
    disturbed = counting(tmp_path / "out", **options)
    chance, told, stop = random.Random(5), [], threading.Event()
    done, disturbances = [], []

    def disturb() -> None:
        for turn in range(3):
            until = len(done) + chance.randint(20, 30)  # by progress: how fast that is, the machine decides
            while len(done) < until and not stop.wait(0.05):
                dask.revive_workers()
            if stop.is_set():
                return
            if turn == 1:
                dask.kill_scheduler()
                disturbances.append("scheduler")
                dask.start_scheduler()
            else:
                name = chance.choice(sorted(dask.workers))
                dask.kill_worker(name)
                disturbances.append(name)
                dask.start_worker(name)
        while not stop.wait(0.3):
            dask.revive_workers()

    supervisor = threading.Thread(target=disturb)
    supervisor.start()
    try:
        results = run_campaign(disturbed, Cluster(dask.address, note=told.append), on_trial=done.append)
    finally:
        stop.set()
        supervisor.join()
    assert disturbances[1] == "scheduler"
    assert len(disturbances) == 3
    assert any("ended; its trials go to others" in note for note in told), told
    assert len(done) == 160
    assert rows_of(results).equals(expected)
    assert once(disturbed)


def test_a_lost_client_costs_no_finished_trial(tmp_path, dask):
    log = tmp_path / "log"
    for name in ("a", "b"):
        dask.start_worker(name, COUNTING_LOG=str(log))
    out = tmp_path / "out"
    client = subprocess.Popen(
        [sys.executable, "-m", "rpod", "campaign", "counting", "--trials", "200", "--pause", "0.02",
         "--cluster", dask.address, "--out", str(out)],
        env=dask.environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    deadline_s = time.monotonic() + 90.0
    while len(lines(log)) < 60:
        assert client.poll() is None, client.stdout.read()
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    end(client, signal.SIGKILL)
    client.stdout.close()
    finished = 0
    while finished != len(lines(log)):  # the workers end their batches
        finished = len(lines(log))
        time.sleep(1.5)
    assert 60 <= finished < 400
    resumed = prepare(CAMPAIGN, CountingOptions(trials=200, pause=0.02), out=out, version=__version__)
    assert len(resumed.done) == finished
    results = run_campaign(resumed, Cluster(dask.address))
    assert len(lines(log)) == len(set(lines(log))) == 400
    expected = run_campaign(counting(tmp_path / "pool", trials=200), ProcessPool(1))
    assert rows_of(results).equals(rows_of(expected))
    assert once(resumed)


def lines(log: Path) -> list[str]:
    return log.read_text().splitlines() if log.exists() else []


class ToldError(Exception):
    """What an executor told; it ends the campaign, so that a test need not wait for its patience to end."""


REFUSED = {
    "old": r"rpod is 0\.0\.9, not 0\.1\.0",
    "broken": "TypeError: 'NoneType'",
    "wide": "OMP_NUM_THREADS is 2, not 1",
}
"""What is wrong with a worker, by its name."""


def test_workers_that_would_give_other_rows_are_refused_by_name_and_others_run_the_trials(tmp_path, dask):
    old, broken = tmp_path / "other_version.py", tmp_path / "broken.py"
    old.write_text(
        "from rpod_campaign.engine import software\n"
        "def other(name, known=software._version):\n"
        "    return '0.0.9' if name == 'rpod' else known(name)\n"
        "software._version = other\n"
    )
    broken.write_text("from rpod_campaign.engine import software\nsoftware._version = None\n")
    dask.start_worker("old", "--preload", str(old))
    dask.start_worker("broken", "--preload", str(broken))
    dask.start_worker("wide", OMP_NUM_THREADS="2")
    told = []

    def end_with_the_last(note: str) -> None:
        told.append(note)
        if len(told) == len(REFUSED):
            raise ToldError

    with pytest.raises(ToldError):  # from here on the workers have imported what they need for their answers
        run_campaign(counting(tmp_path), Cluster(dask.address, note=end_with_the_last))
    for name, reason in REFUSED.items():
        assert any(re.search(rf"worker {name} at tcp://.*{reason}", note) for note in told), told
    with pytest.raises(NoWorkersError, match=REFUSED["old"]):
        run_campaign(counting(tmp_path), Cluster(dask.address, patience_s=2.0))
    dask.start_worker("new")
    campaign, told_again = counting(tmp_path), []
    run_campaign(campaign, Cluster(dask.address, note=told_again.append))
    assert once(campaign)
    assert sorted(note.split(" at ")[0] for note in told_again) == [
        f"refused: worker {name}" for name in sorted(REFUSED)
    ]


def test_rows_go_back_to_the_client_where_a_worker_does_not_see_the_folder(tmp_path, worker, monkeypatch):
    hidden = cluster_module._job
    monkeypatch.setattr(cluster_module, "_job", lambda work: replace(hidden(work), folder="/not/here"))
    campaign = counting(tmp_path, trials=40)
    expected = run_campaign(counting(tmp_path / "pool", trials=40), ProcessPool(1))
    assert rows_of(run_campaign(campaign, Cluster(worker.address))).equals(rows_of(expected))
    assert once(campaign)


def test_an_exception_of_a_worker_is_told_as_what_it_is(tmp_path, worker):
    with pytest.raises(TrialFailedError, match="trial 0, seed 4: ArithmeticError: unlucky") as caught:
        run_campaign(counting(tmp_path, ranges=(13.0,), seed=4), Cluster(worker.address))
    assert isinstance(caught.value.__cause__, ArithmeticError)
    with pytest.raises(TrialFailedError, match="TwoPartsError: mesh: has no triangles"):
        run_campaign(counting(tmp_path, ranges=(14.0,)), Cluster(worker.address))


def test_a_trial_that_ends_every_worker_is_named(tmp_path, site, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", f"{site}:{Path(__file__).parents[1]}")
    with pytest.raises(WorkerDiedError, match=r"ended 3 times .*counting, cell 1 .*factor=99"):
        run_campaign(counting(tmp_path, ranges=(1.0, 99.0), trials=3), Cluster("local:1", patience_s=200.0))
    assert {cell for cell, _ in counting(tmp_path, ranges=(1.0, 99.0), trials=3).done} == {0}


def test_a_target_whose_file_is_on_the_clients_machine_alone_is_sent(tmp_path, worker, monkeypatch):
    import rpod_target  # noqa: PLC0415

    shipped = Path(rpod_target.__file__).parent / "targets" / "envisat-slim.yaml"
    monkeypatch.chdir(tmp_path)
    Path("mine.yaml").write_text(shipped.read_text())
    campaign = find("lidar-acquisition")
    options = campaign.options(
        target=("./mine.yaml",), method=("template-matching",), steps=(60.0,), ranges=(50.0,), trials=6
    )
    far = prepare(campaign, options, out=tmp_path / "far", version="1")
    near = prepare(campaign, options, out=tmp_path / "near", version="1")
    rows = rows_of(run_campaign(far, Cluster(worker.address)))
    assert rows.equals(rows_of(run_campaign(near, ProcessPool(1))))


def test_a_scheduler_that_is_not_there_is_named_as_soon_as_it_says(tmp_path, monkeypatch):
    tried_s, client = [], cluster_module.Client

    def tried(*arguments, timeout, **options):
        tried_s.append(timeout)
        return client(*arguments, timeout=timeout, **options)

    monkeypatch.setattr(cluster_module, "Client", tried)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    with pytest.raises(NoSchedulerError, match=f"{address}: no scheduler answers after 1 s"):
        run_campaign(counting(tmp_path), Cluster(address, patience_s=1.0))
    assert max(tried_s) <= 1.0, "one attempt does not take longer than the patience"


def test_the_script_for_slurm_runs_a_campaign(tmp_path, site):
    stub = tmp_path / "bin" / "srun"
    stub.parent.mkdir()
    stub.write_text('#!/bin/bash\nwhile [[ $1 == --* ]]; do shift; done\nexec "$@"\n')
    stub.chmod(0o755)
    script = Path(__file__).parents[2] / "deploy" / "cluster" / "campaign.slurm"
    environment = os.environ | {
        "PATH": f"{stub.parent}:{os.environ['PATH']}",
        "PYTHONPATH": f"{site}:{Path(__file__).parents[1]}",
        "RPOD_BIN": str(Path(sys.executable).parent),
        "RPOD_CAMPAIGNS": str(tmp_path / "campaigns"),
        "SLURM_NTASKS": "2",
        "SLURM_JOB_ID": "7",
    }
    done = subprocess.run(
        ["bash", str(script), "counting", "--trials", "20"],
        env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=600.0, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert once(counting_of(tmp_path / "campaigns", trials=20))
    assert not (tmp_path / "campaigns" / ".slurm-7").exists()


def counting_of(out: Path, **options) -> Prepared:
    return prepare(CAMPAIGN, CountingOptions(**options), out=out, version=__version__)
