"""Writes a long log of a PMD camera and measures how it is read: ``python -m long_log --gigabytes 10``.

With ``--minutes 10 60 240`` the logs have tiny images and are long in time.
Each figure comes from a process of its own: its peak of memory, and the time from its first look at the file.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from mcap.writer import CompressionType, Writer

from rpod_analysis import open_log
from rpod_analysis.report import write_report
from rpod_schemas.arrays import FloatArray
from rpod_schemas.logs import MESSAGE_ENCODING, PROFILE, SCHEMA_ENCODING
from rpod_schemas.messages import write_image, write_odometry, write_status
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw.cdr import NANOSECONDS, definition, encode, restamped
from rpod_schemas.summary import Summary
from rpod_schemas.topics import AMPLITUDE, CHASER, DEPTH, ESTIMATE, STATUS, TARGET, TRUTH, Topic
from rpod_schemas.types import EstimatorStatus, Mode, Odometry

_SIZE, _TINY = (287, 352), (12, 16)
_DIFFERENT = 97
_FRAME_NS, _TRUTH_NS = NANOSECONDS // 45, NANOSECONDS // 250
_EPOCH_NS = 1_767_225_600 * NANOSECONDS
_SLICE_NS = 10 * NANOSECONDS


def write(path: Path, *, gigabytes: float = inf, minutes: float = inf, size: tuple[int, int] = _SIZE) -> None:
    """Write frames at 45 Hz, truth at 250 Hz and estimates, until the file is that long."""
    noise = np.random.default_rng(1)
    depth_m = noise.normal(5.0, 0.02, size).astype(np.float32)
    amplitude = noise.integers(0, 4000, size).astype(np.uint16)
    truth = _pose_message(np.zeros(3))
    estimates = [_pose_message(noise.normal(0.0, 0.01, 3)) for _ in range(_DIFFERENT)]
    status = EstimatorStatus(
        stamp_ns=0,
        frame_id=CHASER,
        mode=Mode.TRACKING,
        sensor="pmd",
        accepted=True,
        nis=5.0,
        processing_s=0.01,
    )
    frame = {
        DEPTH.of("pmd"): encode(write_image(0, "pmd_optical", depth_m, "32FC1")),
        AMPLITUDE.of("pmd"): encode(write_image(0, "pmd_optical", amplitude, "mono16")),
        ESTIMATE: truth,
        STATUS: encode(write_status(status)),
    }
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.LZ4)
        writer.start(profile=PROFILE)
        channels: dict[Topic, int] = {}
        for topic in (TRUTH, *frame):
            schema = writer.register_schema(topic.type, SCHEMA_ENCODING, definition(topic.type).encode())
            channels[topic] = writer.register_channel(f"/{topic.name}", MESSAGE_ENCODING, schema)
        truth_ns = frame_ns = _EPOCH_NS
        end_ns = _EPOCH_NS + min(minutes, 1e6) * 60 * NANOSECONDS
        while stream.tell() < gigabytes * 1e9 and frame_ns < end_ns:
            while truth_ns < frame_ns + _FRAME_NS:
                writer.add_message(channels[TRUTH], truth_ns, bytes(restamped(truth, truth_ns)), truth_ns)
                truth_ns += _TRUTH_NS
            frame_ns += _FRAME_NS
            frame[ESTIMATE] = estimates[frame_ns // _FRAME_NS % _DIFFERENT]
            for topic, payload in frame.items():
                writer.add_message(channels[topic], frame_ns, bytes(restamped(payload, frame_ns)), frame_ns)
        writer.finish()  # type: ignore[no-untyped-call]
        os.fsync(stream.fileno())


def _pose_message(error_m: FloatArray) -> bytes | bytearray:
    pose = make_pose(translation_m=np.array([0.0, 0.0, 5.0]) + error_m)
    odometry = Odometry(
        stamp_ns=0, frame_id=CHASER, child_frame_id=TARGET, pose=pose, linear_m_s=np.zeros(3),
        angular_rad_s=np.zeros(3), pose_covariance=np.eye(6) * 1e-4,
    )  # fmt: skip
    return encode(write_odometry(odometry))


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


def report(path: Path) -> dict[str, float]:
    """Write report, summary, tables and trajectories of a log: one pass over every byte of it."""
    started_s = time.perf_counter()
    with TemporaryDirectory(dir=path.parent) as directory:
        written = write_report([path], Path(directory))
        count = Summary.model_validate_json(written.summary.read_text("utf-8")).estimates.count
    return {"wall_s": time.perf_counter() - started_s, "estimates": count}


def _measure(what: str, path: Path) -> dict[str, float]:
    command = [sys.executable, "-m", "long_log", "--measure", what, str(path)]
    result: dict[str, float] = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    return result


def main() -> None:
    """Write logs of a tenth of the length and of the whole, and print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gigabytes", type=float, default=10.0)
    parser.add_argument("--minutes", type=float, nargs="+", default=[])
    parser.add_argument("--directory", type=Path)
    parser.add_argument("--measure", nargs=2, metavar=("WHAT", "LOG"))
    arguments = parser.parse_args()
    if arguments.measure:
        what, path = arguments.measure
        begun_s = time.process_time()  # the imports are behind us
        result = {"slice": slice_middle, "report": report}[what](Path(path))
        result["cpu_s"] = time.process_time() - begun_s
        result["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        print(json.dumps(result))  # noqa: T201
        return
    lengths = {f"{minutes:g} min": {"minutes": minutes, "size": _TINY} for minutes in arguments.minutes} or {
        f"{gigabytes:g} GB": {"gigabytes": gigabytes}
        for gigabytes in (arguments.gigabytes / 10.0, arguments.gigabytes)
    }
    figures = {}
    with TemporaryDirectory(dir=arguments.directory) as directory:
        path = Path(directory) / "long.mcap"
        for name, length in lengths.items():
            write(path, **length)
            figures[name] = {what: _measure(what, path) for what in ("slice", "report")}
            print(json.dumps({name: figures[name]}), file=sys.stderr, flush=True)  # noqa: T201
    print(json.dumps(figures, indent=2))  # noqa: T201


if __name__ == "__main__":
    main()
