"""``rpod campaign`` as an operator meets it."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import polars as pl
import psutil
from dask_processes import install_counting

from rpod.campaign.command import campaign_command

CELL = {
    "target", "method", "eq4", "sampling", "centroid", "matcher", "range_m", "step_deg", "trials",
    "discarded_share", "templates", "excluded_share", "success_rate", "wilson_low", "wilson_high", "median_s",
    "p95_s", "wrong_accepted", "right_rejected", "world", "surroundings", "model", "ambiguous",
    "ambiguous_with_truth",
}  # fmt: skip
SMALL = ("lidar-acquisition", "--method", "template-matching", "--steps", "60", "--ranges", "50")


def command(*arguments: str | Path) -> list[str]:
    return [sys.executable, "-m", "rpod", "campaign", *map(str, arguments)]


def campaign(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(*arguments), capture_output=True, text=True, timeout=600.0, check=False)


def test_json_is_one_object_and_the_report_stands_beside_the_trials(tmp_path, capsys):
    done = campaign(*SMALL, "--trials", "3", "--seed", "7", "--jobs", "1", "--json", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    (cell,) = json.loads(done.stdout)["cells"]
    assert set(cell) == CELL
    assert cell["trials"] == 3
    (folder,) = tmp_path.iterdir()
    assert pl.read_parquet(folder / "trials.parquet").height == 3
    assert "Success rate" in (folder / "report.html").read_text("utf-8")
    told = {"method": "template-matching", "steps": "60", "ranges": "50", "trials": 3, "seed": 7}
    assert campaign_command("lidar-acquisition", options=told, jobs=1, out=tmp_path, as_json=False) == 0
    said = capsys.readouterr()
    assert said.err == f"resuming {folder}: 3 of 3 trials are done\n"
    assert str(folder / "report.html") in said.out


def test_a_signal_leaves_what_is_done_to_the_next_run_and_no_process_behind(tmp_path):
    site, out = install_counting(tmp_path), tmp_path / "out"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(site), str(Path(__file__).parents[1])))}
    arguments = (
        "counting",
        "--ranges",
        "1",
        "--pause",
        "0.01",
        "--trials",
        "20000",
        "--jobs",
        "1",
        "--out",
        out,
    )
    kept = 0
    for number in (signal.SIGINT, signal.SIGTERM):
        running = subprocess.Popen(
            command(*arguments),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
            start_new_session=True,
        )
        deadline_s = time.monotonic() + 60.0
        while trials_in(out) == kept:
            assert running.poll() is None
            assert time.monotonic() < deadline_s
            time.sleep(0.1)
        children = psutil.Process(running.pid).children(recursive=True)
        assert children
        running.send_signal(number)
        _, said = running.communicate(timeout=30.0)
        assert running.returncode == 130
        assert "interrupted; the finished trials are kept in" in said.splitlines()[-1]
        assert not psutil.wait_procs(children, timeout=10.0)[1]
        assert said.startswith("resuming" if kept else "starting")
        assert not kept or f"{kept} of 20000 trials are done" in said
        kept = trials_in(out)


def trials_in(out: Path) -> int:
    """Return how many trials are kept."""
    return sum(pl.read_parquet(file).height for file in out.glob("*/part-*.parquet"))
