"""A Dask scheduler and workers as processes on loopback, as an operator starts them, each ended by its id."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

TESTS = Path(__file__).parent
_READY_S = 60.0
_IDLE = {
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "500ms",
}
"""Settings by which a process that waits for work does not look at itself a hundred times a second."""
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def install_counting(folder: Path) -> Path:
    """Make the counting campaign an installed package's; return the folder for the search path."""
    site = folder / "site"
    information = site / "counting-1.0.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: counting\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text("[rpod.campaigns]\ncounting = counting_campaign:CAMPAIGN\n")
    return site


class DaskProcesses:
    """A scheduler that comes again on its port, and workers."""

    def __init__(self, folder: Path, *paths: Path) -> None:
        self.folder, self.environment = folder, os.environ | _ONE_THREAD | _IDLE
        self.environment["PYTHONPATH"] = os.pathsep.join(map(str, (*paths, TESTS)))
        self._file = folder / "scheduler.json"
        self._scheduler: subprocess.Popen[bytes] | None = None
        self.workers: dict[str, subprocess.Popen[bytes]] = {}
        self.address = ""

    def __enter__(self) -> "DaskProcesses":
        self.start_scheduler()
        return self

    def __exit__(self, *_: object) -> None:
        for process in (*self.workers.values(), self._scheduler):
            if process is not None:
                end(process, signal.SIGKILL)

    def start_scheduler(self) -> None:
        """Start the scheduler, on the port that it had."""
        port = self.address.rpartition(":")[2] or "0"
        self._file.unlink(missing_ok=True)
        self._scheduler = self._start(
            "dask_scheduler", "--host", "127.0.0.1", "--port", port, "--scheduler-file", str(self._file)
        )
        deadline_s = time.monotonic() + _READY_S
        while not self.address or not self._file.exists():
            assert self._scheduler.poll() is None, self._log("dask_scheduler")
            assert time.monotonic() < deadline_s, self._log("dask_scheduler")
            try:
                self.address = json.loads(self._file.read_text())["address"]
            except (OSError, ValueError):
                time.sleep(0.05)

    def kill_scheduler(self) -> None:
        """End the scheduler at once."""
        assert self._scheduler is not None
        end(self._scheduler, signal.SIGKILL)

    def start_worker(self, name: str, *options: str, **environment: str) -> None:
        """Start a worker of one thread."""
        self.workers[name] = self._start(
            "dask_worker", self.address, "--name", name, "--nthreads", "1", "--no-nanny",
            "--host", "127.0.0.1", "--local-directory", str(self.folder / "workers"), *options,
            log=name, **environment,
        )  # fmt: skip

    def kill_worker(self, name: str) -> None:
        """End a worker at once."""
        end(self.workers.pop(name), signal.SIGKILL)

    def revive_workers(self) -> None:
        """Start those workers again that ended by themselves, as a supervisor would."""
        for name, process in list(self.workers.items()):
            if process.poll() is not None:
                self.start_worker(name)

    def _start(
        self, program: str, *arguments: str, log: str = "", **environment: str
    ) -> subprocess.Popen[bytes]:
        work = self.folder / "elsewhere"
        work.mkdir(exist_ok=True)
        with (self.folder / f"{log or program}.log").open("ab") as stream:
            return subprocess.Popen(
                [
                    sys.executable,
                    "-m",
                    f"distributed.cli.{program}",
                    "--no-dashboard",
                    "--dashboard-address",
                    "127.0.0.1:0",
                    *arguments,
                ],
                cwd=work,
                env=self.environment | environment,
                stdout=stream,
                stderr=stream,
            )

    def _log(self, name: str) -> str:
        return (self.folder / f"{name}.log").read_text("utf-8", "replace")[-3000:]


def end(process: "subprocess.Popen[bytes]", number: signal.Signals) -> None:
    """Send a signal to a process that we started, and wait for its end."""
    if process.poll() is None:
        process.send_signal(number)
    process.wait(timeout=20.0)
