"""A driver process without a device: what it does stands in its first argument."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np


def image(number):
    return np.full((3, 4), number, np.float32)


def stream(sender, count, **fields):
    camera = {"width": 4, "height": 3, "fx": 5.0, "fy": 5.0, "cx": 1.5, "cy": 1.0}
    sender.send("info", text="four pixels wide", frame={"camera": camera}, **fields)
    for number in range(count):
        arrays = {"depth_m": image(number), "amplitude": image(number).astype(np.uint16)}
        sender.send("frame", arrays, stamp_ns=10**12 + number * 10**7)


def crash_after(sender, count):
    stream(sender, count)
    sys.stderr.write("bus error in the library\n")
    sys.stderr.flush()
    os._exit(7)


def printing(sender):
    sys.stdout.write("a library prints this\n")
    sys.stdout.flush()
    os.write(1, b"and this from compiled code\n")
    stream(sender, 2)
    sender.send("end")


def tell(sender):
    stream(sender, 0)
    sender.send("error", text="the sensor is too hot")


def silent(sender):
    stream(sender, 1)
    while True:
        sender.send("idle")
        time.sleep(0.02)


def pausing(sender):
    """Send a frame, a pause of 1.5 s that is announced, and another frame."""
    stream(sender, 1)
    sender.send("idle", pause_s=1.5)
    time.sleep(1.5)
    sender.send("frame", {"depth_m": image(1)}, stamp_ns=2 * 10**12)
    sender.send("end")


def pausing_for_ever(sender):
    stream(sender, 1)
    sender.send("idle", pause_s="for ever")


def environment(sender):
    told = {"path": sys.path, "venv": os.environ.get("VIRTUAL_ENV"), "modules": sorted(sys.modules)}
    sender.send("error", text=repr(told))


def hang(_sender):
    time.sleep(600)


def garbage(sender):
    sender.send("info")
    sender._stream.write(b"Traceback (most recent call last):")


def early(sender):
    sender.send("frame")


def wrong(sender):
    sender.send("info")
    sender.send("frame", {"depth_m": image(1)}, stamp_ns=1)


def partial(sender):
    sender.send("info")
    for number in range(12):
        points = np.zeros((2, 3, 3), np.float32)
        sender.send("frame", {"points_m": points}, stamp_ns=10**12 + number, partial="lacks 7 columns")
    sender.send("end")


def scan(sender):
    """Send a scan of 8 s, the last column of which was not received."""
    time_s = np.tile(np.array([-4.0, 0.0, 4.0, np.nan], np.float32), (2, 1))
    sender.send("info")
    sender.send("frame", {"points_m": np.ones((2, 4, 3), np.float32), "time_s": time_s}, stamp_ns=10**12)
    sender.send("end")


def pid(sender, file):
    Path(file).write_text(str(os.getpid()))
    silent(sender)


def parent(sender):
    subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"], start_new_session=False)
    silent(sender)


def recorded(sender, file):
    sender._stream.write(Path(file).read_bytes())


def paced(sender):
    """Send a slanted plane with noise, 20 frames a second, as if taken now."""
    camera = {"width": 40, "height": 30, "fx": 31.0, "fy": 31.0, "cx": 19.5, "cy": 14.5}
    random, next_s = np.random.default_rng(1), time.time()
    plane = np.add.outer(np.linspace(2.5, 2.0, 30), np.linspace(0.0, 0.3, 40))
    sender.send("info", text="a plane", frame={"camera": camera})
    while True:
        next_s += 0.05
        time.sleep(max(0.0, next_s - time.time()))
        depth_m = (plane + 0.006 * random.standard_normal(plane.shape)).astype(np.float32)
        sender.send("frame", {"depth_m": depth_m}, stamp_ns=round(1e9 * next_s))


def repeated(sender, file):
    """Send the recorded frames again and again, 20 a second, as if taken now."""
    with Path(file).open("rb") as stream:
        messages = list(iter(lambda: frame_pipe.receive(stream), None))
    (info, *frames) = [each for each in messages if each.kind in ("info", "frame")]
    sender.send("info", info.arrays, **info.fields)
    next_s = time.time()
    while True:
        for frame in frames:
            next_s += 0.05
            time.sleep(max(0.0, next_s - time.time()))
            sender.send("frame", frame.arrays, **frame.fields | {"stamp_ns": round(1e9 * next_s)})


def ten(sender):
    stream(sender, 10)
    sender.send("end")


if __name__ == "__main__":
    import frame_pipe

    does = {"crash": lambda sender: crash_after(sender, 2)} | globals()
    does[sys.argv[1]](frame_pipe.open_sender(), *sys.argv[2:])
