"""One service that is kept alive, with a process that stands for a service."""

import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

import pytest
import yaml

from rpod.service_process import ServiceFiles, close_pipe
from rpod.up.daemon import Daemon
from rpod.up.resolved import resolve_facility
from rpod_schemas.config.facility.hosts import BackoffConfig

_STANDS_FOR_A_SERVICE = """
import os, pathlib, signal, socket, sys, time
signal.signal(signal.SIGHUP, lambda *_: pathlib.Path(sys.argv[1]).write_text("reloaded"))
while not pathlib.Path(sys.argv[2]).exists():
    time.sleep(0.01)
told = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
told.sendto(b"READY=1", os.environ["NOTIFY_SOCKET"])
time.sleep(60.0)
"""


def test_long_log_lines_are_moved_aside_while_the_process_writes_on(tmp_path: Path):
    files = ServiceFiles(tmp_path, "router")
    process = files.start(["--version"], {})  # the file of log lines is open in it
    assert process.wait(60.0) == 0
    close_pipe(process)
    version = files.log.read_bytes()
    files.shorten_log()
    assert files.log.read_bytes() == version
    with files.log.open("ab") as stream:  # as the process has it
        stream.write(bytes(17 << 20))
        stream.flush()
        files.shorten_log()
        stream.write(b"the next line")
    assert files.log.read_bytes() == b"the next line"
    assert files.log.with_suffix(".log.1").read_bytes() == version + bytes(17 << 20)


def test_a_configuration_that_changes_during_the_start_is_read_again_when_the_service_is_ready(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    reloaded, go = tmp_path / "reloaded", tmp_path / "go"

    def start(_: ServiceFiles, __: list[str], environment: dict[str, str]) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-c", _STANDS_FOR_A_SERVICE, str(reloaded), str(go)],
            env=environment,
            stdin=subprocess.PIPE,
        )

    monkeypatch.setattr(ServiceFiles, "start", start)
    path = tmp_path / "hall.yaml"
    path.write_text(yaml.safe_dump({"name": "hall", "services": {"router": {"verb": "router"}}}), "utf-8")
    (service,) = resolve_facility(path).services
    (tmp_path / "logs").mkdir()
    with (
        tempfile.TemporaryDirectory() as sockets,  # the path of a socket has to be short
        closing(Daemon(service, state=tmp_path, sockets=Path(sockets), backoff=BackoffConfig())) as daemon,
    ):
        daemon.start()
        try:
            daemon.reload(service)
            go.touch()
            deadline_s = time.monotonic() + 20.0
            while not reloaded.exists() and time.monotonic() < deadline_s:
                daemon.turn()
                time.sleep(0.01)
            assert reloaded.exists()
        finally:
            daemon.stop(5.0)
