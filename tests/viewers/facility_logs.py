"""Short logs as the facility makes them, for the readers."""

import json
import subprocess
import sys
from pathlib import Path

from logger_desk import Desk

from rpod.play.progress import Progress
from rpod.play.run import RunFolder, play
from rpod.scenarios import find
from rpod_analysis.recovery import recover
from rpod_runtime import Received
from rpod_schemas.messages import NANOSECONDS, write_clock
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.rmw.wire import Attachment
from rpod_schemas.summary import Summary
from rpod_schemas.topics import CLOCK, Namespace, Topic

HERE = Path(__file__).parent
RUN_TIMEOUT_S = 400.0
"""The first run on a machine compiles kernels and builds the target."""
OPAQUE = Topic("robot/telegram", "")


def play_a_run(out: Path) -> Summary:
    """Play the standard scenario for two seconds by ``rpod run``, with its report."""
    command = ["run", "mockup-tumbling", "--duration", "2", "--speed", "max", "--out", str(out), "--json"]
    done = subprocess.run(
        [sys.executable, "-m", "rpod", *command],
        capture_output=True,
        text=True,
        timeout=RUN_TIMEOUT_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return Summary.model_validate_json(done.stdout)


def play_every_sensor(out: Path) -> Path:
    """Play a camera with its raw samples beside a LIDAR; return the log."""
    scenario = find(str(HERE / "every-sensor.yaml"))
    folder = RunFolder.make(out, scenario)
    with Progress(quiet=True) as progress:
        play(scenario, folder, speed="max", progress=progress)
    return folder.log


def cut_and_recover(log: Path, out: Path) -> Path:
    """Cut a log at two thirds of its bytes, as a loss of power does; return what can be had of it."""
    whole, cut = log.read_bytes(), out / "cut.mcap"
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    return Path(recover(cut).out)


def record_what_is_no_ros_message(out: Path, compression: str) -> Path:
    """Record JSON of a robot, which the logger keeps as opaque bytes, between clocks; return the log."""
    desk = Desk(out, compression=compression)
    with desk.recorder:
        desk.recorder.start()
        for number in (1, 2):
            desk.put(_received(CLOCK, Namespace().key(CLOCK), encode(write_clock(number)), number))
            telegram = json.dumps({"joints_rad": [0.1 * number] * 6}).encode()
            desk.put(_received(OPAQUE, f"{Namespace().root}/{OPAQUE.name}", telegram, number))
        return Path(desk.recorder.stop().path)


def _received(topic: Topic, key: str, payload: bytes | bytearray, number: int) -> Received:
    stamp_ns = NANOSECONDS * number
    attachment = Attachment(number, stamp_ns, b"g" * 16)
    return Received(topic, key, memoryview(payload), attachment, stamp_ns, arrival_s=number)
