"""``rpod bench``: speed of the parts on this machine with one thread each, as medians with spread."""

import json
import os
import platform
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import RigidTransform, Rotation

from rpod import __version__
from rpod.console import table_console
from rpod_geometry.rays import RayGrid, cast
from rpod_logger.writer import LogFile, WriterSettings
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.methods import methods_of
from rpod_pose.navigation.dynamics.options import Dynamics
from rpod_pose.navigation.filter import start
from rpod_pose.navigation.history import History, apply
from rpod_pose.navigation.pose_measurement import PoseMeasurement
from rpod_runtime import Inbox, Node, Received
from rpod_runtime.bus.session import free_endpoint, open_router
from rpod_runtime.process.lifecycle import EXIT_OK
from rpod_schemas.config.estimator import LidarInput, PmdInput
from rpod_schemas.config.estimator.dynamics import DynamicsConfig
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.motion import FACING
from rpod_schemas.config.pmd import MAX_RATE_HZ, PmdConfig
from rpod_schemas.config.service import BusConfig, RouterConfig, ServiceConfig
from rpod_schemas.messages import NANOSECONDS, write_image
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.rmw.wire import Attachment
from rpod_schemas.topics import DEPTH, Namespace
from rpod_schemas.types import LidarScan, PmdFrame
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_sim_sensor.pmd import PmdEmulator
from rpod_target import load_target

_SUN_W_m2 = np.array([680.0, -817.0, -844.0])
_OBLIQUE = Rotation.from_euler("ZYX", (30.0, 40.0, 20.0), degrees=True)
"""A typical attitude of the LIDAR's target: no face is perpendicular to the line of sight."""
_BUS_HZ = 45.0
_BUS_FRAMES = 135


@dataclass(frozen=True)
class Row:
    """One figure: median, quartiles, and the share of a core that it needs, at its rate or while it runs."""

    name: str
    unit: str
    median: float
    low: float
    """First quartile."""
    high: float
    """Third quartile."""
    runs: int
    core_share: float
    rate_hz: float | None = None


def bench_command(*, as_json: bool) -> int:
    """Measure and print; return the exit code."""
    console = Console(markup=False, stderr=True, quiet=as_json)
    rows: list[Row] = []
    for measure in (_rays, _lidar, _pmd, _filter, _bus, _log):
        console.print(f"measuring {measure.__name__.strip('_')} ...", style="dim")
        rows += measure()
    if as_json:
        machine = {
            "cores": os.cpu_count(),
            "machine": platform.machine(),
            "python": platform.python_version(),
        }
        print(
            json.dumps(
                {"version": __version__, "machine": machine, "rows": [asdict(row) for row in rows]}, indent=2
            )
        )
    else:
        table_console().print(_table(rows))
    return EXIT_OK


def _table(rows: list[Row]) -> Table:
    table = Table(title=f"rpod {__version__}, Python {platform.python_version()}, {os.cpu_count()} cores")
    for heading in ("what", "median", "quartiles", "", "runs", "share of a core"):
        table.add_column(heading, justify="left" if heading == "what" else "right")
    for row in rows:
        when = f"at {row.rate_hz:g} Hz" if row.rate_hz else "while it runs"
        share = f"{100 * row.core_share:.1f} % {when}"
        spread = f"{row.low:.3g} to {row.high:.3g}"
        table.add_row(row.name, f"{row.median:.3g}", spread, row.unit, str(row.runs), share)
    return table


def _timed(name: str, call: Callable[[], object], *, runs: int, rate_hz: float | None = None) -> Row:
    """Time a call in ms. The first run is not counted."""
    call()
    wall_ms, busy_s = np.empty(runs), np.empty(runs)
    for index in range(runs):
        started_s, started_busy_s = time.perf_counter(), time.process_time()
        call()
        busy_s[index] = time.process_time() - started_busy_s
        wall_ms[index] = 1e3 * (time.perf_counter() - started_s)
    low, median, high = np.percentile(wall_ms, [25, 50, 75])
    share = float(np.median(busy_s)) * rate_hz if rate_hz else float(busy_s.sum() / wall_ms.sum() * 1e3)
    return Row(name, "ms", float(median), float(low), float(high), runs, share, rate_hz)


def _per_second(row: Row, *, items: int, unit: str) -> Row:
    """Convert ms per run to millions of items per second."""
    scale = items * 1e3 / 1e6
    return Row(
        row.name, unit, scale / row.median, scale / row.high, scale / row.low, row.runs, row.core_share
    )


def _facing(range_m: float) -> RigidTransform:
    return make_pose(rotation=FACING, translation_m=[0.0, 0.0, range_m])


def _rays() -> Iterator[Row]:
    mockup, envisat = load_target("mockup"), load_target("envisat-mesh")
    pixels = RayGrid.pinhole(PmdConfig().camera, samples=2)
    pattern = LidarConfig()
    scan = RayGrid.azimuth_elevation(pattern.azimuth_rad, pattern.elevation_rad)
    for name, grid, target, range_m in (
        ("rays, mock-up at 2.5 m, 704 x 574", pixels, mockup, 2.5),
        ("rays, ENVISAT mesh at 30 m, 41 x 41", scan, envisat, 30.0),
    ):
        row = _timed(name, partial(cast, grid, target.triangles_m, _facing(range_m)), runs=40)
        yield _per_second(row, items=grid.directions.shape[0] * grid.directions.shape[1], unit="million/s")


def _lidar() -> Iterator[Row]:
    config, target = LidarConfig(), load_target("envisat-bulky")
    emulator = LidarEmulator(config, target, seed=1)
    methods = methods_of(LidarInput(), target, ScanPattern.of(config.info()))
    for range_m in (20.0, 50.0):
        pose = _facing(range_m) * make_pose(rotation=_OBLIQUE)
        poses = [pose] * len(config.pose_times_s())
        yield _timed(
            f"LIDAR scan, ENVISAT at {range_m:g} m",
            partial(_next_scan, emulator, poses, count()),
            runs=40,
            rate_hz=config.rate_hz,
        )
        returns = emulator.scan(poses, frame=0)
        scan = LidarScan(stamp_ns=0, frame_id="lidar", points_m=returns.points_m)
        yield _timed(
            f"LIDAR acquisition, ENVISAT at {range_m:g} m",
            partial(methods.acquirer.acquire, scan),
            runs=5,
        )
        guess = make_pose(translation_m=[0.1, -0.2, 0.1]) * pose * _turn_deg(4.0)
        yield _timed(
            f"LIDAR tracking, ENVISAT at {range_m:g} m",
            partial(methods.tracker.track, scan, guess),
            runs=20,
            rate_hz=config.rate_hz,
        )


def _next_scan(emulator: LidarEmulator, poses: list[RigidTransform], frames: Iterator[int]) -> None:
    emulator.scan(poses, frame=next(frames))


def _next_exposure(emulator: PmdEmulator, poses: list[RigidTransform], frames: Iterator[int]) -> None:
    emulator.expose(poses, sun_W_m2=_SUN_W_m2, frame=next(frames))


def _pmd() -> Iterator[Row]:
    config, target = PmdConfig(rate_hz=MAX_RATE_HZ), load_target("mockup")
    emulator = PmdEmulator(config, target, seed=1)
    methods = methods_of(PmdInput(), target)
    for range_m in (7.0, 4.0, 2.5, 1.0):
        pose = _facing(range_m)
        yield _timed(
            f"PMD frame, mock-up at {range_m:g} m",
            partial(_next_exposure, emulator, [pose] * 4, count()),
            runs=40,
            rate_hz=config.rate_hz,
        )
        exposure = emulator.expose([pose] * 4, sun_W_m2=_SUN_W_m2, frame=0)
        frame = PmdFrame(
            stamp_ns=0,
            frame_id="pmd_optical",
            depth_m=exposure.depth_m.copy(),
            amplitude=exposure.amplitude.copy(),
            camera=config.camera,
        )
        guess = make_pose(translation_m=[0.002, -0.001, 0.002]) * pose * _turn_deg(0.2)
        yield _timed(
            f"PMD tracking at {range_m:g} m",
            partial(methods.tracker.track, frame, guess),
            runs=40,
            rate_hz=config.rate_hz,
        )
        yield _timed(
            f"PMD acquisition at {range_m:g} m",
            partial(methods.acquirer.acquire, frame),
            runs=5,
        )


def _turn_deg(angle_deg: float) -> RigidTransform:
    return make_pose(rotation=Rotation.from_rotvec([angle_deg, 0.0, 0.0], degrees=True))


def _filter() -> Iterator[Row]:
    """Measure an update of the filter with a pose of a calm spin, as it is after some poses.

    Without torque, a filter with a constant rate is updated beside the track.
    """
    target, sigma = load_target("mockup"), np.repeat([0.003, 0.003], 3)
    for motion in (DynamicsConfig(), DynamicsConfig(target="torque_free")):
        dynamics = Dynamics.of(motion, target)
        state = start(
            _facing(5.0),
            np.diag(sigma**2),
            0,
            config=FilterConfig(),
            centre_of_mass_m=target.centre_of_mass_m,
            blocks=dynamics.blocks_at(0),
            model=dynamics.model,
        )
        for number in range(1, 20):
            time_s = number / MAX_RATE_HZ
            pose, stamp_ns = _facing(5.0) * _turn_deg(5.0 * time_s), round(time_s * NANOSECONDS)
            measured, history = PoseMeasurement(stamp_ns, pose, np.diag(sigma**2), alone=True), History(state)
            state = apply(history, measured, FilterConfig()).history.state
        yield _timed(
            f"filter, one pose, {motion.target}",
            partial(apply, history, measured, FilterConfig()),
            runs=200,
            rate_hz=MAX_RATE_HZ,
        )


def _bus() -> Iterator[Row]:
    """Measure the latency of one image of 0.4 MB through a router on loopback, from encoding to arrival."""
    image = np.full((287, 352), 2.5, np.float32)
    topic = DEPTH.of("bench")
    inbox = Inbox()
    with ExitStack() as stack:
        endpoint = free_endpoint()
        stack.enter_context(open_router(RouterConfig(listen=endpoint)))
        bus = BusConfig(connect=endpoint)
        names = ("bench-out", "bench-in")
        sender, receiver = (
            stack.enter_context(Node(ServiceConfig(instance=name, bus=bus), version=__version__))
            for name in names
        )
        receiver.subscribe(topic, inbox.put, recover=True)
        publisher = sender.publisher(topic)
        latency_ms, busy_s = [], time.process_time()
        pace, started_s = Event(), time.perf_counter()
        for number in range(_BUS_FRAMES):
            pace.wait(max(0.0, started_s + number / _BUS_HZ - time.perf_counter()))
            sent_ns = time.time_ns()
            publisher.publish(write_image(sent_ns, "", image, "32FC1"))
            latency_ms += [(item.arrival_ns - sent_ns) / 1e6 for item in inbox.wait(1.0)[-1:]]
        share = (time.process_time() - busy_s) / (time.perf_counter() - started_s)
    low, median, high = np.percentile(latency_ms, [25, 50, 75])
    name = "bus latency, one image, router and both ends in one process"
    yield Row(name, "ms", float(median), float(low), float(high), len(latency_ms), share, _BUS_HZ)


def _log() -> Iterator[Row]:
    """Measure the writing of two images a frame to MCAP with lz4; the images are noisy like a camera's."""
    generator = np.random.default_rng(1)
    image = (2.5 + 0.01 * generator.standard_normal((287, 352))).astype(np.float32)
    image[:, :150] = np.nan
    payload = memoryview(encode(write_image(0, "pmd_optical", image, "32FC1")))
    keys = Namespace()
    topic = DEPTH.of("pmd")
    frames = 90
    with TemporaryDirectory() as folder:
        names = count()

        def write() -> None:
            settings = WriterSettings(keys=keys, library=f"rpod {__version__}")
            log = LogFile(Path(folder) / f"{next(names)}.mcap", settings)
            for index in range(frames):
                attachment = Attachment(index + 1, index, bytes(16))
                log.write(Received(topic, keys.key(topic), payload, attachment, index))
            log.close()

        row = _timed("log, 0.4 MB images, lz4", write, runs=10)
    megabytes_s = _per_second(row, items=frames * len(payload), unit="MB/s")
    share = row.median / 1e3 / frames * 2 * 15.0
    yield replace(megabytes_s, core_share=share, rate_hz=15.0)
