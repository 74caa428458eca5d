"""A router, a logger and a camera as processes on this machine, and what the logger does meanwhile."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event

import numpy as np
import psutil
from mcap.reader import make_reader

from rpod import __version__
from rpod_runtime import Node, Publisher, QueryFailedError
from rpod_runtime.bus.session import free_endpoint
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.config.service import BusConfig, ServiceConfig
from rpod_schemas.control import StatusReply
from rpod_schemas.logs import COMPLETENESS, COUNTS, Completeness, check_completeness
from rpod_schemas.messages import write_camera, write_image, write_odometry
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.topics import AMPLITUDE, CAMERA_INFO, CHASER, DEPTH, PHASE, TARGET, TRUTH, Topic
from rpod_schemas.types import Odometry

CAMERA = "pmd"
_TRUTH_HZ = 250.0
_READY_TIMEOUT_S = 60.0
_SETTLE_S = 2.0
"""In which what is missing is recovered, before the logger is stopped."""
_VARIANTS = 4
"""Frames with different noise, in turn."""
_TELL_S = 60.0


@dataclass(frozen=True)
class Load:
    """What the camera sends, and for how long."""

    duration_s: float
    rate_hz: float
    raw: bool
    """Whether Q1..Q4 are sent, at one frequency."""


@dataclass(frozen=True)
class Sample:
    """The logger's process at one moment."""

    time_s: float
    """From the first frame."""
    cpu_s: float
    rss_bytes: int


Tell = Callable[[Sample, dict[str, int]], None]
"""Gets the logger's process and its counters, now and then."""


@dataclass(frozen=True)
class Result:
    """What it came to."""

    samples: Sequence[Sample]
    late_frames: int
    """That the camera sent more than a period late: then it is the machine that is too slow."""
    sent_bytes: int
    files: Sequence[Completeness]
    file_bytes: int
    counters: dict[str, int]
    """The logger's own, at the end."""


class Shelf:
    """The log's files: each is held against its own record of completeness once it is closed."""

    def __init__(self, directory: Path, *, keep: bool) -> None:
        self.said: dict[str, Completeness] = {}
        self.size_bytes = 0
        self._directory, self._keep = directory, keep

    def check(self, *, last_too: bool = False) -> None:
        """Check what is new, and remove what need not stay; the last file is still written."""
        paths = sorted(self._directory.glob("*.mcap"))
        for path in paths if last_too else paths[:-1]:
            if path.name not in self.said:
                self.said[path.name] = _completeness(path)
                self.size_bytes += path.stat().st_size
                if not self._keep and not last_too:
                    path.unlink()


def measure(load: Load, *, out: Path | None, settings: Sequence[str], tell: Tell) -> Result:
    """Record for a while.

    Args:
        load: what is sent.
        out: where the log goes, and stays; where left out, files are removed as they are closed.
        settings: lines of YAML for the logger's configuration.
        tell: is told how it goes, each minute.
    """
    with ExitStack() as stack:
        folder = out or Path(stack.enter_context(TemporaryDirectory()))
        endpoint = free_endpoint()
        stack.enter_context(_process("router", folder, f"listen: {endpoint}"))
        bus = BusConfig(connect=endpoint, wait=True)
        shelf = Shelf(folder / "logs", keep=out is not None)
        directory = f"directory: {folder / 'logs'}"
        logger = stack.enter_context(
            _process("logger", folder, directory, f"bus: {{connect: {endpoint}}}", *settings)
        )
        node = stack.enter_context(Node(ServiceConfig(instance="camera", bus=bus), version=__version__))
        _await_logger(node)
        process, samples, told = psutil.Process(logger.pid), list[Sample](), 0

        def each_second(time_s: float) -> None:
            nonlocal told
            samples.append(_sample(process, time_s))
            shelf.check()
            if time_s >= told * _TELL_S:
                told += 1
                tell(samples[-1], _counters(node))

        late, sent = _send(node, load, each_second)
        node.stop.wait(_SETTLE_S)
        counters = _counters(node)
        tell(samples[-1], counters)
        logger.terminate()
        logger.wait()
        shelf.check(last_too=True)
    return Result(samples, late, sent, tuple(shelf.said.values()), shelf.size_bytes, counters)


@contextmanager
def _process(verb: str, folder: Path, *settings: str) -> Iterator[subprocess.Popen[bytes]]:
    config = folder / f"{verb}.yaml"
    config.write_text("\n".join(settings) + "\n", "utf-8")
    process = subprocess.Popen([sys.executable, "-m", "rpod", verb, "--config", str(config)])
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


def _await_logger(node: Node) -> None:
    deadline_s = time.monotonic() + _READY_TIMEOUT_S
    while True:
        try:
            if node.ask("logger", "status", StatusReply).state == "ready":
                return
        except QueryFailedError:
            if time.monotonic() > deadline_s:
                raise
        node.stop.wait(0.1)


def _counters(node: Node) -> dict[str, int]:
    return node.ask("logger", "status", StatusReply, timeout_s=_READY_TIMEOUT_S).counters


def _send(node: Node, load: Load, each_second: Callable[[float], None]) -> tuple[int, int]:
    """Publish frames, and truth between them, at their rates; return how many were late, and the bytes."""
    frames = _frames(load)
    camera = [node.publisher(topic) for topic in frames[0]]
    truth, odometry = node.publisher(TRUTH), encode(write_odometry(_still()))
    pace, late, sent, told, started_s = Event(), 0, 0, 0, time.monotonic()
    for number in range(round(load.duration_s * load.rate_hz)):
        due_s = number / load.rate_hz
        while (now_s := time.monotonic() - started_s) < due_s:
            pace.wait(due_s - now_s)
        late += now_s > due_s + 1.0 / load.rate_hz
        sent += _publish(camera, frames[number % _VARIANTS])
        while truth.published < now_s * _TRUTH_HZ:
            truth.put(odometry)
        if now_s >= told:
            each_second(now_s)
            told += 1
    return late, sent


def _publish(camera: Sequence[Publisher], frame: dict[Topic, bytearray]) -> int:
    for publisher in camera:
        publisher.put(frame[publisher.topic])
    return sum(len(payload) for payload in frame.values())


def _frames(load: Load) -> list[dict[Topic, bytearray]]:
    """Return encoded frames that are all noise, so that no compression flatters."""
    generator = np.random.default_rng(1)
    camera = PmdConfig().camera
    shape = camera.height, camera.width
    frames = []
    for _ in range(_VARIANTS):
        depth_m = generator.normal(5.0, 0.05, shape).astype(np.float32)
        amplitude = generator.integers(0, 4000, shape, dtype=np.uint16)
        frame = {
            CAMERA_INFO: write_camera(1, CAMERA, camera),
            DEPTH: write_image(1, CAMERA, depth_m, "32FC1"),
            AMPLITUDE: write_image(1, CAMERA, amplitude, "mono16"),
        }
        if load.raw:
            samples = generator.integers(30_000, 36_000, (*shape, 4), dtype=np.uint16)
            frame[PHASE] = write_image(1, CAMERA, samples, "16UC4")
        frames.append({topic.of(CAMERA): encode(message) for topic, message in frame.items()})
    return frames


def _still() -> Odometry:
    still = np.zeros(3)
    return Odometry(
        stamp_ns=1,
        frame_id=CHASER,
        child_frame_id=TARGET,
        pose=make_pose(),
        linear_m_s=still,
        angular_rad_s=still,
    )


def _sample(process: psutil.Process, time_s: float) -> Sample:
    times = process.cpu_times()
    return Sample(time_s, times.user + times.system, process.memory_info().rss)


def _completeness(path: Path) -> Completeness:
    with path.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        records = {item.name: item.metadata for item in reader.iter_metadata()}
    if summary is None or summary.statistics is None:
        return Completeness.of_record({})
    counts = summary.statistics.channel_message_counts
    messages = {channel.topic: counts.get(number, 0) for number, channel in summary.channels.items()}
    return check_completeness(records.get(COMPLETENESS, {}), records.get(COUNTS, {}), messages)
