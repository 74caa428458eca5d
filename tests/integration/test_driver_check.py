"""``rpod driver check`` on a real bus: emulator and driver are in order, and seeded faults are named."""

import json
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, redirect_stdout
from io import StringIO
from threading import Event, Thread

import numpy as np
import pytest
from checked_sensors import INFO, wall_frames
from live_bus import TIMEOUT_S, Bus, daemon

from rpod.driver.check import CheckOptions, check_command
from rpod_driver import run as run_driver
from rpod_emulator.daemon import run
from rpod_motion.daemon import run as run_motion
from rpod_runtime import Node
from rpod_runtime.errors import QueryFailedError
from rpod_schemas.config.driver import DriverConfig
from rpod_schemas.config.emulator import EmulatorConfig, MotionServiceConfig
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.control import StatusReply
from rpod_schemas.faults import PlannedFault
from rpod_schemas.types import Camera

SIZES = {"lost_messages": 0.4}
"""Sizes of faults that a loaded machine, which sends a few frames only, still shows."""
CAMERA = Camera(width=64, height=48, fx=110.0, fy=110.0, cx=31.5, cy=23.5)


class Walls:
    """A driver that plays the camera before a wall, as if taken now."""

    def connect(self):
        return INFO

    def frames(self):
        pause, start_ns = Event(), time.time_ns()
        for number, frame in enumerate(wall_frames(1, 600.0)):
            stamp_ns = start_ns + number * 100_000_000
            pause.wait(max(0.0, (stamp_ns - time.time_ns()) * 1e-9))
            yield frame.model_copy(update={"stamp_ns": stamp_ns})

    def close(self) -> None:
        pass


def options_of(name, endpoint, *, rate_hz=10.0, target=None) -> CheckOptions:
    return CheckOptions(
        name, "pmd", config=None, source=None, connect=endpoint, rate_hz=rate_hz, target=target
    )


def checked(bus, capsys, name="pmd", *, rate_hz=10.0, duration_s=3.0, target=None) -> tuple[int, dict]:
    """Run the verb; return its exit code and its JSON."""
    options = options_of(name, bus.endpoint, rate_hz=rate_hz, target=target)
    capsys.readouterr()
    code = check_command(options, duration_s=duration_s, as_json=True)
    return code, json.loads(capsys.readouterr().out)


@contextmanager
def emulated(bus, *faults: str):
    """Run motion and emulator with a camera for each fault, of its name, or one without; all are at work."""
    names = faults or ("pmd",)
    emulator = EmulatorConfig(
        bus=bus.config,
        target="mockup",
        sensors=tuple(PmdConfig(name=name, rate_hz=10.0, camera=CAMERA) for name in names),
        faults=tuple(PlannedFault(fault=fault, sensor=fault, size=SIZES.get(fault)) for fault in faults),
    )
    motion = MotionServiceConfig(
        bus=bus.config,
        target="mockup",
        duration_s=120.0,
        motion={
            "trajectory": {"kind": "approach", "start_m": [0.0, 0.0, 3.5], "end_m": [0.0, 0.0, 3.0]},
            "attitude": {"kind": "tumble", "rate_deg_s": [3.0, 8.0, 2.0]},
        },
    )
    node = bus.node("observer")
    with daemon(run, emulator), daemon(run_motion, motion):
        deadline_s = time.monotonic() + TIMEOUT_S
        while not is_at_work(node, names) and time.monotonic() < deadline_s:
            Event().wait(0.1)
        yield


def is_at_work(node: Node, names: tuple[str, ...]) -> bool:
    """Return whether the emulator answers and has published some frames of each camera."""
    try:
        status = node.ask("emulator", "status", StatusReply, timeout_s=TIMEOUT_S)
    except QueryFailedError:  # its code is still being compiled
        return False
    return all(status.counters.get(f"frames/{name}", 0) >= 3 for name in names)


TRIES = 3
"""Number of times that a sensor in order is looked at: a machine that stands still loses frames."""


def test_the_emulator_is_in_order_and_beside_truth_too(bus, capsys):
    with emulated(bus):
        for _ in range(TRIES):
            code, told = checked(bus, capsys, duration_s=9.0, target="mockup")
            if told["ok"]:
                break
    assert told["faults"] == []
    assert (code, told["ok"]) == (0, True)
    levels = {each["line"]: each["level"] for each in told["verdicts"]}
    assert {line for line in levels if levels[line] == "ok"} >= {
        "publisher", "rate", "gaps", "bus", "parts", "clock", "order", "frozen", "returns", "unit", "qos",
        "lens",
    }  # fmt: skip
    assert {levels["mount"], levels["range"]} <= {"ok", "not checked"}, (
        "of a loaded machine too few frames may come"
    )


FAULTS = (
    "tai_clock",
    "second_publisher",
    "lost_messages",
    "frozen",
    "no_mount",
    "missing_part",
    "not_latched",
    "slow_link",
)


@pytest.fixture(scope="module")
def answers(endpoint) -> dict[str, tuple[int, dict]]:
    """Exit code and JSON of the verb for each fault: cameras with a fault each, checked at once.

    A machine that stands still sends too few frames. What is not named is looked at again.
    """
    told: dict[str, tuple[int, dict]] = {}
    with ExitStack() as stack:
        stack.enter_context(emulated(Bus(endpoint, stack), *FAULTS))
        for _ in range(TRIES):
            told |= checked_at_once(endpoint, [name for name in FAULTS if not is_named(told, name)])
    return told


def is_named(told: dict[str, tuple[int, dict]], fault: str) -> bool:
    return fault in told and fault in told[fault][1]["faults"]


def checked_at_once(endpoint: str, names: list[str]) -> dict[str, tuple[int, dict]]:
    """Return exit code and JSON of the verb for several cameras; empty for none."""
    with redirect_stdout(StringIO()) as printed, ThreadPoolExecutor(len(FAULTS)) as pool:
        options = [options_of(name, endpoint) for name in names]
        codes = list(pool.map(lambda each: check_command(each, duration_s=6.0, as_json=True), options))
    text, told = printed.getvalue().lstrip(), {}
    while text:
        one, end = json.JSONDecoder().raw_decode(text)
        told[one["sensor"]], text = one, text[end:].lstrip()
    return {name: (code, told[name]) for name, code in zip(names, codes, strict=True)}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_the_emulator_is_named_and_the_exit_code_is_1(answers, fault):
    code, told = answers[fault]
    assert code == 1, json.dumps(told, indent=1)
    assert fault in told["faults"]
    assert all(each["remedy"] for each in told["verdicts"] if fault in each["faults"])


def test_a_driver_on_the_bus_is_in_order(bus, capsys):
    stop = Event()
    config = DriverConfig(bus=bus.config, kind="pmd", name="front")
    thread = Thread(target=run_driver, args=(Walls(), config), kwargs={"version": "test", "stop": stop})
    with ExitStack() as stack:
        stack.callback(thread.join, TIMEOUT_S)
        stack.callback(stop.set)
        thread.start()
        bus.node("waiting").ask("driver", "status", StatusReply, timeout_s=TIMEOUT_S)
        code, told = checked(bus, capsys, "front", duration_s=4.0)
    assert (code, told["faults"]) == (0, []), told
    model = next(each for each in told["verdicts"] if each["line"] == "depth_model")
    assert model["level"] == "ok"
    assert np.isfinite(model["figures"]["rms_z_m"])


def test_without_a_sensor_the_exit_code_is_1_and_the_line_says_so(bus, capsys):
    code, told = checked(bus, capsys, "nobody", duration_s=0.5)
    assert (code, told["faults"]) == (1, ["silence"])


def test_what_cannot_be_asked_is_refused_in_one_line(capsys):
    options = CheckOptions("pmd", "radar", config=None, source=None, connect=None, rate_hz=None, target=None)
    assert check_command(options, duration_s=1.0, as_json=True) == 2
    assert "kind" in capsys.readouterr().err
    options = CheckOptions("pmd", "pmd", config=None, source=None, connect=None, rate_hz=-3.0, target=None)
    assert check_command(options, duration_s=1.0, as_json=True) == 2
    assert "--rate is -3" in capsys.readouterr().err


def test_without_a_router_the_check_ends_although_its_driver_would_wait(tmp_path, capsys):
    file = tmp_path / "driver.yaml"
    bus = {"connect": "tcp/127.0.0.1:9", "wait": True, "connect_timeout_s": 0.1}
    file.write_text(json.dumps({"kind": "pmd", "name": "front", "bus": bus}))
    options = CheckOptions("pmd", None, config=file, source=None, connect=None, rate_hz=None, target=None)
    assert check_command(options, duration_s=1.0, as_json=True) == 1
    assert "no router at tcp/127.0.0.1:9" in capsys.readouterr().err
