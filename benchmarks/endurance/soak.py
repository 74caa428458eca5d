"""Watches a facility for hours: memory, threads, descriptors and latency, beside a bare echo."""

import json
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Lock

import numpy as np
import plotly.graph_objects as go
import psutil
from plotly.subplots import make_subplots
from scipy.stats import t as student

from endurance.echo import Echo
from endurance.facility import SERVICES, KeptFacility
from endurance.kills import false_claims
from rpod import __version__
from rpod_runtime import Node, Received
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.service import BusConfig, ServiceConfig
from rpod_schemas.messages import read_status
from rpod_schemas.topics import STATUS

FRAME_BYTES = 405_504
"""Size of an echo's ping: a depth image of 352 x 288 pixels."""
_SAMPLE_S = 1.0
_MINUTE_S = 60.0
_SETTLED = 0.5
"""Share of the time, from the beginning, that slopes leave out: caches, queues and the allocator's arenas
fill in steps, the last of them after a quarter of an hour."""
_FILLED_S = 540.0
"""Least time that slopes leave out: each node keeps its last 500 diagnostics, one a second, for receivers
that missed them. Until then its memory grows by their size, 0.2 MiB a minute in the logger."""
_LEAST_MINUTES = 4
_MEBI = 1 << 20


@dataclass(frozen=True)
class Slope:
    """Growth of a quantity, a minute, with its 95 % interval."""

    per_minute: float
    low: float
    high: float


@dataclass(frozen=True)
class Soak:
    """What was seen."""

    processes: Mapping[str, FloatArray]
    """Samples of each service: time, s; resident memory, MiB; threads; descriptors; processor time, s."""
    latency: FloatArray
    """Time, s, and latency from a frame's stamp to its status, s."""
    echo: FloatArray
    """Time, s, and round trip of a frame's bytes and a short answer, s."""
    missed: Mapping[str, int]
    """Messages that a service missed, by service and topic, where there are any."""
    wrong: tuple[str, ...]
    """Files of the log that are not complete."""
    messages: int
    """Number of messages that the logger received."""


class _Latencies:
    """Latency of each status."""

    def __init__(self, node: Node, begin_s: float) -> None:
        self._begin_s, self._lock = begin_s, Lock()
        self._found: list[tuple[float, float]] = []
        node.subscribe(STATUS, self._take)

    def _take(self, received: Received) -> None:
        stamp_ns = read_status(received.decode()).stamp_ns
        with self._lock:
            latency_s = (received.arrival_ns - stamp_ns) * 1e-9
            self._found.append((received.arrival_s - self._begin_s, latency_s))

    def all(self) -> FloatArray:
        with self._lock:
            return np.array(self._found).reshape(-1, 2)


def watch(facility: KeptFacility, *, seconds: float, rate_hz: float) -> Soak:
    """Watch a facility that is at work."""
    bus = BusConfig(connect=facility.endpoint, wait=True)
    processes = {name: psutil.Process(facility.service(name)["pid"]) for name in SERVICES}
    samples: dict[str, list[tuple[float, ...]]] = {name: [] for name in SERVICES}
    wrong, checked = list[str](), set[Path]()
    with (
        Node(ServiceConfig(instance="soak", bus=bus), version=__version__, stop=Event()) as node,
        Echo(facility.endpoint, rate_hz=rate_hz, size_bytes=FRAME_BYTES) as echo,
    ):
        begin_s = time.monotonic()
        latencies, round_trips = _Latencies(node, begin_s), list[tuple[float, float]]()
        while (time_s := time.monotonic() - begin_s) < seconds:
            for name, process in processes.items():
                samples[name].append((time_s, *_sample(process)))
            round_trips += [(sent_s - begin_s, came_s - sent_s) for sent_s, came_s in echo.take()]
            wrong += _wrong_in_closed(facility.logs, checked)
            node.stop.wait(_SAMPLE_S)
        statuses = node.ask_all(timeout_s=10.0)
    found = {status.name: status.counters for status in statuses}
    return Soak(
        processes={name: np.array(rows) for name, rows in samples.items()},
        latency=latencies.all(),
        echo=np.array(round_trips).reshape(-1, 2),
        missed=_missed(found),
        wrong=tuple(wrong),
        messages=sum(
            count for name, count in found.get("logger", {}).items() if name.startswith("received/")
        ),
    )


def _sample(process: psutil.Process) -> tuple[float, ...]:
    with process.oneshot():
        times = process.cpu_times()
        memory = process.memory_info().rss / _MEBI
        return memory, process.num_threads(), process.num_fds(), times.user + times.system


def _wrong_in_closed(logs: Path, checked: set[Path]) -> Iterator[str]:
    """Check the files that the logger has closed, and remove them: hours of images fill a disk."""
    for path in sorted(logs.glob("*.mcap"), key=lambda path: (len(path.name), path.name))[:-1]:
        if path not in checked:
            checked.add(path)
            yield from false_claims(path, killed="")
            path.unlink()


def _missed(counters: Mapping[str, Mapping[str, int]]) -> dict[str, int]:
    return {
        f"{service} {name}": count
        for service, counts in counters.items()
        for name, count in counts.items()
        if name.startswith(("missed/", "lost/")) and count
    }


def slope(rows: FloatArray, column: int) -> Slope | None:
    """Return the growth of a column, from its medians of each minute; None for too short a time.

    The interval is that of a straight line by least squares (Student's t), with fewer degrees of freedom
    where the residuals follow each other: n (1 - r) / (1 + r) for a correlation r of successive ones.
    """
    begin_s = max(_FILLED_S, _SETTLED * rows[-1, 0])
    late = rows[rows[:, 0] >= begin_s]
    minute = ((late[:, 0] - begin_s) // _MINUTE_S).astype(int)
    x = np.unique(minute)
    if len(x) < _LEAST_MINUTES:
        return None
    y = np.array([np.median(late[minute == each, column]) for each in x])
    centred = x - x.mean()
    rate = float(centred @ y / (centred @ centred))
    rest = y - y.mean() - rate * centred
    power = float(rest @ rest)
    follows = float(np.clip(rest[1:] @ rest[:-1] / power, 0.0, 0.9)) if power else 0.0
    free = max(1.0, len(x) * (1.0 - follows) / (1.0 + follows) - 2.0)
    sigma = float(np.sqrt(power / free / (centred @ centred)))
    reach = float(student.ppf(0.975, free)) * sigma
    return Slope(rate, rate - reach, rate + reach)


def quantiles_ms(rows: FloatArray) -> dict[str, float]:
    """Return median, p99, p99.9 and the most of a column of times, ms."""
    if not len(rows):
        return {}
    values = 1e3 * np.quantile(rows[:, 1], [0.5, 0.99, 0.999, 1.0])
    return dict(zip(("p50", "p99", "p99.9", "most"), values.round(1).tolist(), strict=True))


def figures(soak: Soak) -> dict[str, object]:
    """Return the figures as a document."""
    names = {"memory_mib": 1, "threads": 2, "descriptors": 3}
    return {
        "seconds": round(float(soak.processes[SERVICES[0]][-1, 0]), 1),
        "slopes_per_minute": {
            service: {
                name: None if found is None else [round(value, 4) for value in vars(found).values()]
                for name, column in names.items()
                for found in [slope(rows, column)]
            }
            for service, rows in soak.processes.items()
        },
        "latency_ms": quantiles_ms(soak.latency),
        "echo_ms": quantiles_ms(soak.echo),
        "frames": len(soak.latency),
        "messages": soak.messages,
        "missed": dict(soak.missed),
        "not_complete": list(soak.wrong),
    }


def write(soak: Soak, folder: Path) -> Path:
    """Write figures and page into a folder; return the page."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "soak.json").write_text(json.dumps(figures(soak), indent=2) + "\n", "utf-8")
    titles = "resident memory, MiB", "threads", "descriptors", "latency and echo, ms"
    page = make_subplots(rows=4, cols=1, shared_xaxes=True, subplot_titles=titles)
    for name, rows in soak.processes.items():
        for row in (1, 2, 3):
            one = {"name": name, "legendgroup": name, "showlegend": row == 1}
            page.add_trace(go.Scatter(x=rows[:, 0] / _MINUTE_S, y=rows[:, row], **one), row=row, col=1)
    for name, values in (("stamp to status", soak.latency), ("bare echo", soak.echo)):
        points = {"name": name, "mode": "markers", "marker_size": 3}
        minutes, milliseconds = values[:, 0] / _MINUTE_S, 1e3 * values[:, 1]
        page.add_trace(go.Scattergl(x=minutes, y=milliseconds, **points), row=4, col=1)
    page.update_yaxes(type="log", row=4, col=1)
    page.update_xaxes(title_text="time, min", row=4, col=1)
    page.update_layout(height=1100, template="plotly_white", title="Soak")
    file = folder / "soak.html"
    page.write_html(file, include_plotlyjs=True)
    return file
