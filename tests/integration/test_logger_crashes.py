"""A logger that is really killed: its log holds all but the last moment, and the next one goes on."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic

import numpy as np
import pytest
from live_bus import TIMEOUT_S
from logger_desk import early_metadata, readable

from rpod_runtime import Node, QueryFailedError
from rpod_schemas.control import StatusReply
from rpod_schemas.messages import write_clock
from rpod_schemas.topics import CLOCK

SYNC_S = 0.2


@contextmanager
def logger_process(endpoint: str, directory: Path, namespace: str) -> Iterator[subprocess.Popen[bytes]]:
    config = directory.parent / "logger.yaml"
    bus = f"bus: {{namespace: {namespace}}}"
    config.write_text(f"directory: {directory}\nname: run\nsync_interval_s: {SYNC_S}\n{bus}\n", "utf-8")
    command = [sys.executable, "-m", "rpod", "logger", "--config", str(config), "--connect", endpoint]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def await_logger(node: Node) -> None:
    deadline_s = monotonic() + 3 * TIMEOUT_S
    while True:
        try:
            if node.ask("logger", "status", StatusReply).state == "ready":
                return
        except QueryFailedError:
            assert monotonic() < deadline_s
            node.stop.wait(0.05)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_killed_logger_leaves_all_but_the_last_moment(bus, tmp_path, seed):
    namespace = f"killed{seed}"
    node = bus.node("publisher", namespace=namespace)
    clock = node.publisher(CLOCK)
    lasts_s = np.random.default_rng(seed).uniform(1.0, 2.0)
    sent = kept = 0
    with logger_process(bus.endpoint, tmp_path / "logs", namespace) as process:
        await_logger(node)
        until_s = monotonic() + lasts_s
        log, channel = tmp_path / "logs" / "run.mcap", f"/{namespace}/clock"
        while monotonic() < until_s or kept < 100:  # while more comes, what came before gets to the disk
            assert monotonic() < until_s + TIMEOUT_S
            sent += 1
            clock.publish(write_clock(sent))
            node.stop.wait(0.002)
            if sent % 50 == 0:
                kept = len(readable(log, channel))
        process.send_signal(signal.SIGKILL)
        process.wait()
    left = log.read_bytes()
    numbers = readable(log, channel)
    assert numbers == list(range(1, len(numbers) + 1))
    assert sent >= len(numbers) >= kept
    assert "logger" in early_metadata(log, "configuration")
    with logger_process(bus.endpoint, tmp_path / "logs", namespace) as process:
        await_logger(node)
        process.send_signal(signal.SIGTERM)
        assert process.wait(TIMEOUT_S) == 0
    assert log.read_bytes() == left
    assert readable(tmp_path / "logs" / "run_0002.mcap", f"/{namespace}/clock")
