"""Processes that play sensors on a bus of their own: the facility's emulator, and drivers without it."""

import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from rpod_runtime.bus.session import free_endpoint

CAMERA = {"width": 64, "height": 48, "fx": 110.0, "fy": 110.0, "cx": 31.5, "cy": 23.5}
SENSORS: dict[str, dict[str, Any]] = {
    "pmd": {"rate_hz": 10.0, "camera": CAMERA},
    "lidar": {
        "rate_hz": 5.0,
        "motion": "skewed",
        "pattern": {"azimuth_span_deg": 24.0, "elevation_span_deg": 24.0, "step_deg": 0.6},
    },
}
"""The emulated sensors, by kind."""
_MOTION = {
    "trajectory": {"kind": "approach", "start_m": [0.0, 0.0, 3.5], "end_m": [0.0, 0.0, 3.0]},
    "attitude": {"kind": "sway", "amplitude_deg": [30.0, 30.0, 40.0], "period_s": [7.0, 9.0, 11.0]},
}
_LASTS_S = 600.0


class Case(NamedTuple):
    """One sensor that is watched."""

    kind: str
    fault: str
    """Name in the catalogue; empty for a sensor in order."""
    seed: int

    @property
    def name(self) -> str:
        """Name of the sensor on the bus."""
        return f"{self.kind}_{self.fault or 'good'}"


class Bus:
    """A router and the processes on it; they end with it."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.endpoint, self._folder, self._stack = free_endpoint(), folder, stack
        self.start("router", "--listen", self.endpoint)

    def start(self, *command: str, config: dict[str, Any] | None = None) -> None:
        """Start ``rpod`` with a command, which ends with the bus."""
        words = [sys.executable, "-m", "rpod", *command]
        if config is not None:
            path = self._folder / f"{'-'.join(command)}.json"
            path.write_text(json.dumps(config | {"bus": {"connect": self.endpoint}}), "utf-8")
            words += ["--config", str(path)] if command[0] != "driver" else [str(path)]
        said = self._stack.enter_context((self._folder / f"{'-'.join(command[:2])}.log").open("wb"))
        process = subprocess.Popen(words, stdout=said, stderr=said)
        self._stack.callback(process.wait)
        self._stack.callback(process.kill)

    def emulate(self, cases: Sequence[Case]) -> None:
        """Start motion and emulator with a sensor for each case, all of one seed."""
        sensors = [{"kind": case.kind, "name": case.name} | SENSORS[case.kind] for case in cases]
        faults = [{"fault": case.fault, "sensor": case.name} for case in cases if case.fault]
        emulator = {"target": "mockup", "sensors": sensors, "faults": faults, "seed": cases[0].seed}
        self.start("emulator", config=emulator)
        self.start("motion", config={"target": "mockup", "duration_s": _LASTS_S, "motion": _MOTION})


@contextmanager
def bus(folder: Path) -> Iterator[Bus]:
    """Run a router on an ephemeral port of loopback."""
    with ExitStack() as stack:
        yield Bus(folder, stack)
