"""Lockstep ends where time ends: runs of one seed are the same to the last bit of their last message.

The scenario has a camera and a LIDAR. One run is alone, one has another hash seed, and one is beside a busy
process. Diagnostics are left out, whose times are those of the wall clock, and so are processing times.
"""

import subprocess
import sys
from contextlib import ExitStack, closing
from pathlib import Path

from facility_process import FacilityProcess
from mcap.reader import make_reader

from rpod_schemas.cdr import decode, encode
from rpod_schemas.topics import (
    CLOCK,
    DEPTH,
    DIAGNOSTICS,
    ESTIMATE,
    PARAMETER_EVENTS,
    POINTS,
    ROSOUT,
    STATUS,
    TRUTH,
)

BOTH = """
name: both
title: The mock-up by a camera and a LIDAR
target: mockup
duration_s: 1
seed: 7
motion:
  trajectory: {kind: approach, start_m: [0, 0, 4], end_m: [0, 0, 3]}
  attitude: {kind: spin, axis: [1, 0, 0], rate_deg_s: 5}
  sun: {direction: [0.5, -0.6, -0.62]}
sensors: [{kind: pmd, rate_hz: 10}, {kind: lidar, rate_hz: 2}]
estimator: {sensors: [{kind: pmd}, {kind: lidar}]}
"""


def content(log: Path) -> dict[str, list[bytes]]:
    """Return the messages of each topic in the order of their numbers, without processing times."""
    found: dict[str, list[tuple[int, bytes]]] = {}
    with log.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            data, name = bytes(message.data), channel.topic.lstrip("/")
            if name == STATUS.name:
                status = decode(data, schema.name)
                status.processing_s = 0.0
                data = bytes(encode(status))
            found.setdefault(name, []).append((message.sequence, data))
    for name in (DIAGNOSTICS.name, ROSOUT.name, PARAMETER_EVENTS.name):  # in order of processes' own time
        found.pop(name, None)
    return {name: [data for _, data in sorted(messages)] for name, messages in found.items()}


def test_runs_of_one_seed_are_equal_to_the_last_message(tmp_path, monkeypatch):
    path, contents = tmp_path / "both.yaml", {}
    path.write_text(BOTH, "utf-8")
    for name, hash_seed in (("alone", "0"), ("another hash seed", "77"), ("beside a busy process", "0")):
        monkeypatch.setenv("PYTHONHASHSEED", hash_seed)
        with ExitStack() as stack:
            if name == "beside a busy process":
                busy = stack.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
                stack.callback(busy.kill)
            out = tmp_path / name.replace(" ", "-")
            run = stack.enter_context(closing(FacilityProcess(str(path), "--speed", "max", out=out)))
            finished = run.finish()
        assert finished.code == 0, finished.stderr
        contents[name] = content(finished.log)
    alone = contents["alone"]
    counts = {topic.name: len(alone[topic.name]) for topic in (DEPTH.of("pmd"), POINTS.of("lidar"), STATUS)}
    assert counts[STATUS.name] == sum(counts.values()) - counts[STATUS.name], "each frame has its status"
    assert all(alone[topic.name] for topic in (TRUTH, CLOCK, ESTIMATE))
    for name, other in contents.items():
        differs = [topic for topic in alone.keys() | other.keys() if alone.get(topic) != other.get(topic)]
        assert not differs, name
