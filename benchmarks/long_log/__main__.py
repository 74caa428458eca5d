"""Writes a long log of a PMD camera and measures how it is read: ``python -m long_log --gigabytes 10``.

Each figure comes from a process of its own: its peak of memory, and the time from its first look at the file.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from mcap.writer import CompressionType, Writer

from rpod_analysis import open_log, read_run
from rpod_analysis.summarise import summarise
from rpod_schemas.cdr import NANOSECONDS, definition, encode, restamped
from rpod_schemas.logs import MESSAGE_ENCODING, PROFILE, SCHEMA_ENCODING
from rpod_schemas.messages import write_image, write_odometry, write_status
from rpod_schemas.poses import make_pose
from rpod_schemas.topics import AMPLITUDE, CHASER, DEPTH, ESTIMATE, STATUS, TARGET, TRUTH, Topic
from rpod_schemas.types import EstimatorStatus, Mode, Odometry

_SIZE = (287, 352)
_FRAME_NS, _TRUTH_NS = NANOSECONDS // 45, NANOSECONDS // 250
_EPOCH_NS = 1_767_225_600 * NANOSECONDS
_SLICE_NS = 10 * NANOSECONDS


def write(path: Path, gigabytes: float) -> None:
    """Write frames at 45 Hz, truth at 250 Hz and estimates, until the file is that long."""
    noise = np.random.default_rng(1)
    depth_m = noise.normal(5.0, 0.02, _SIZE).astype(np.float32)
    amplitude = noise.integers(0, 4000, _SIZE).astype(np.uint16)
    pose = make_pose(translation_m=(0.0, 0.0, 5.0))
    odometry = {
        "stamp_ns": 0, "frame_id": CHASER, "child_frame_id": TARGET, "pose": pose,
        "linear_m_s": np.zeros(3), "angular_rad_s": np.zeros(3), "pose_covariance": np.eye(6) * 1e-4,
    }  # fmt: skip
    pose_message = encode(write_odometry(Odometry(**odometry)))
    status = EstimatorStatus(stamp_ns=0, frame_id=CHASER, mode=Mode.TRACKING, sensor="pmd", accepted=True)
    frame = {
        DEPTH.of("pmd"): encode(write_image(0, "pmd_optical", depth_m, "32FC1")),
        AMPLITUDE.of("pmd"): encode(write_image(0, "pmd_optical", amplitude, "mono16")),
        ESTIMATE: pose_message,
        STATUS: encode(write_status(status)),
    }
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.LZ4)
        writer.start(profile=PROFILE)
        channels: dict[Topic, int] = {}
        for topic in (TRUTH, *frame):
            schema = writer.register_schema(topic.type, SCHEMA_ENCODING, definition(topic.type).encode())
            channels[topic] = writer.register_channel(f"/{topic.name}", MESSAGE_ENCODING, schema)
        truth_ns, frame_ns = _EPOCH_NS, _EPOCH_NS
        while stream.tell() < gigabytes * 1e9:
            while truth_ns < frame_ns + _FRAME_NS:
                writer.add_message(
                    channels[TRUTH], truth_ns, bytes(restamped(pose_message, truth_ns)), truth_ns
                )
                truth_ns += _TRUTH_NS
            frame_ns += _FRAME_NS
            for topic, payload in frame.items():
                writer.add_message(channels[topic], frame_ns, bytes(restamped(payload, frame_ns)), frame_ns)
        writer.finish()  # type: ignore[no-untyped-call]
        os.fsync(stream.fileno())


def slice_middle(path: Path) -> dict[str, float]:
    """Open a log and take ten seconds of all topics from its middle."""
    started_s = time.perf_counter()
    with open_log(path) as log:
        opened_s = time.perf_counter() - started_s
        middle_ns = (log.start_ns + log.end_ns) // 2
        found = list(log.messages(start_ns=middle_ns, end_ns=middle_ns + _SLICE_NS))
    return {
        "open_s": opened_s,
        "wall_s": time.perf_counter() - started_s,
        "messages": len(found),
        "payload_mb": sum(len(logged.payload) for logged in found) / 1e6,
    }


def summary(path: Path) -> dict[str, float]:
    """Summarise a log: one pass over every byte of it."""
    started_s = time.perf_counter()
    with open_log(path) as log:
        result = summarise(log, read_run(log))
    return {"wall_s": time.perf_counter() - started_s, "estimates": result.estimates.count}


def _measure(what: str, path: Path) -> dict[str, float]:
    command = [sys.executable, "-m", "long_log", "--measure", what, str(path)]
    result: dict[str, float] = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    return result


def main() -> None:
    """Write logs of a tenth of the length and of the whole, and print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gigabytes", type=float, default=10.0)
    parser.add_argument("--directory", type=Path)
    parser.add_argument("--measure", nargs=2, metavar=("WHAT", "LOG"))
    arguments = parser.parse_args()
    if arguments.measure:
        what, path = arguments.measure
        begun_s = time.process_time()  # the imports are behind us
        result = {"slice": slice_middle, "summary": summary}[what](Path(path))
        result["cpu_s"] = time.process_time() - begun_s
        result["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        print(json.dumps(result))  # noqa: T201
        return
    figures = {}
    with TemporaryDirectory(dir=arguments.directory) as directory:
        for gigabytes in (arguments.gigabytes / 10.0, arguments.gigabytes):
            path = Path(directory) / "long.mcap"
            write(path, gigabytes)
            figures[f"{gigabytes:g} GB"] = {what: _measure(what, path) for what in ("slice", "summary")}
    print(json.dumps(figures, indent=2))  # noqa: T201


if __name__ == "__main__":
    main()
