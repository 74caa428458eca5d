"""A whole facility under ``rpod up``: its processes, what it publishes, and what its logger says."""

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any, TypeVar

import yaml

from rpod_runtime.bus.session import free_endpoint

T = TypeVar("T")

SERVICES = "router", "motion", "emulator", "estimator", "logger"
DEADLINE_S = 180.0
"""Longest time until something that must happen has happened; the first start compiles kernels."""
_DAY_S = 86_400.0
_TUMBLING = {
    "trajectory": {"kind": "approach", "start_m": [0.0, 0.0, 4.0], "end_m": [0.0, 0.0, 3.9]},
    "attitude": {"kind": "spin", "axis": [1, 0, 0], "rate_deg_s": 5},
    "sun": {"direction": [0.5, -0.6, -0.62]},
}
"""A mock-up that turns 4 m away for days."""


class NotInTimeError(AssertionError):
    """Something that must happen did not."""


def until(condition: Callable[[], T | None], what: str, timeout_s: float = DEADLINE_S) -> T:
    """Wait until a condition gives something; return it. Raises ``NotInTimeError``."""
    deadline_s, pause = time.monotonic() + timeout_s, Event()
    while not (found := condition()):
        if time.monotonic() > deadline_s:
            raise NotInTimeError(f"{what}: not within {timeout_s:g} s")
        pause.wait(0.005)
    return found


class KeptFacility:
    """Processes of a facility that ``rpod up`` keeps."""

    def __init__(self, folder: Path, endpoint: str) -> None:
        self.endpoint = endpoint
        self.logs = folder / "logs"
        self._status = folder / "hall.state" / "status.json"

    def service(self, name: str) -> dict[str, Any]:
        """Return what ``rpod ps`` says of a service; empty before the first word."""
        try:
            told = json.loads(self._status.read_text("utf-8"))["services"]
        except FileNotFoundError:
            return {}
        return next(each for each in told if each["name"] == name)

    def in_reserve(self, name: str) -> bool:
        """Return whether a service has a warm process in reserve."""
        return bool(self.service(name).get("reserve") == "ready")

    def ready(self, name: str, restarts: int = 0) -> dict[str, Any] | None:
        """Return a service that is at work after so many restarts, or more; None if it is not yet."""
        told = self.service(name)
        return told if told and told["state"] == "ready" and told["restarts"] >= restarts else None


@contextmanager
def kept_facility(
    folder: Path,
    *,
    rate_hz: float,
    sensor: str = "pmd",
    logger: dict[str, Any] | None = None,
    reserve: bool = False,
) -> Iterator[KeptFacility]:
    """Run router, motion, emulator, estimator and logger under ``rpod up``, until all are at work.

    The wait before a restart is always the first one, 0.1 s: kills follow each other more closely than
    accidents do.

    Args:
        folder: empty folder of its files.
        rate_hz: frames of the sensor a second.
        sensor: kind of the sensor.
        logger: more fields of the logger's configuration.
        reserve: whether the services have a process in reserve.
    """
    endpoint = free_endpoint()
    target = {"target": "mockup"}
    files = {"directory": str(folder / "logs"), "name": "hall"}
    motion = {"duration_s": 10 * _DAY_S, "motion": _TUMBLING, "epoch_ns": time.time_ns()}
    document: dict[str, Any] = {
        "name": "hall",
        "bus": {"connect": endpoint},
        "backoff": {"first_s": 0.1, "max_s": 0.1},
        "services": {
            "router": {"verb": "router"},
            "logger": {"verb": "logger", "config": files | (logger or {})},
            "estimator": {"verb": "estimator", "config": target | {"sensors": [{"kind": sensor}]}},
            "emulator": {
                "verb": "emulator",
                "config": target | {"sensors": [{"kind": sensor, "rate_hz": rate_hz}]},
            },
            "motion": {"verb": "motion", "config": target | motion},
        },
    }  # fmt: skip
    for service in document["services"].values():
        service |= {"reserve": reserve}
    path = folder / "hall.yaml"
    path.write_text(yaml.safe_dump(document, sort_keys=False), "utf-8")
    with (folder / "up.log").open("wb") as said:
        process = subprocess.Popen([sys.executable, "-m", "rpod", "up", str(path)], stderr=said)
        try:
            facility = KeptFacility(folder, endpoint)
            for name in SERVICES:
                until(partial(facility.ready, name), f"{name} at work")
            yield facility
        finally:
            process.terminate()
            process.wait()
