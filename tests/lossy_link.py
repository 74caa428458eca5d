"""Two network namespaces joined by a link that loses packets, for tests: real TCP, real loss.

The link is a pair of TUN devices and a relay between them, which drops packets at random, by a seed, and
passes them at a rate. It needs no rights beyond a user namespace of one's own, and of programs ``unshare``
and ``ip`` alone; netem or nftables are not needed. ``python lossy_link.py near JSON`` plays one case.
"""

import fcntl
import json
import os
import random
import select
import shutil
import socket
import struct
import subprocess
import sys
import time
from collections import deque
from dataclasses import asdict, dataclass
from pathlib import Path

_TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
_NEAR, _FAR = "10.9.0.1", "10.9.0.2"
_ENDPOINT = f"tcp/{_NEAR}:7447"
_QUEUED = 200
"""Packets that wait for a slow link; more are dropped, as by a switch."""


@dataclass(frozen=True)
class Case:
    """What is played: a link, and what is sent over it."""

    loss: float
    """Share of the packets that are lost, in each direction."""
    rate_mbit_s: float = 0.0
    """Rate of the link, Mbit/s; unlimited if 0."""
    truth: int = 500
    """Number of messages of truth, at 250 Hz."""
    frame_hz: float = 5.0
    """Rate of a camera's frames of 76 kB."""
    seed: int = 1


@dataclass(frozen=True)
class Outcome:
    """What came of it on the other side."""

    truth: int
    """Messages of truth that arrived."""
    missed: int
    """Messages of truth that never came."""
    in_order: bool
    """Whether they came in order."""
    recovered: int
    """Messages of truth that were fetched from the publisher's cache."""
    frames_sent: int
    frames: int
    """Complete frames that arrived."""
    gap_s: float
    """Longest time without truth, s."""
    dropped: int
    """Packets that the link lost at random."""
    passed: int


def why_not() -> str:
    """Return why there can be no such link on this machine; empty if there can be."""
    for program in ("unshare", "ip"):
        if shutil.which(program) is None:
            return f"{program} is not installed"
    if not Path("/dev/net/tun").exists():
        return "there is no /dev/net/tun"
    tried = subprocess.run(
        ["unshare", "-rn", sys.executable, __file__, "try"], capture_output=True, text=True, check=False
    )
    return "" if tried.returncode == 0 else f"namespaces or TUN are forbidden: {tried.stderr.strip()[-200:]}"


def play(case: Case, timeout_s: float) -> Outcome:
    """Play a case in namespaces of its own."""
    done = subprocess.run(
        ["unshare", "-rn", sys.executable, __file__, "near", json.dumps(asdict(case))],
        capture_output=True, text=True, timeout=timeout_s, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return Outcome(**json.loads(done.stdout.splitlines()[-1]))


def _tun(address: str) -> int:
    """Return a new TUN device of this namespace, with an address."""
    device = os.open("/dev/net/tun", os.O_RDWR)
    fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH", b"tun0", _IFF_TUN | _IFF_NO_PI))
    for command in ("link set lo up", f"addr add {address}/24 dev tun0", "link set tun0 up"):
        subprocess.run(["ip", *command.split()], check=True)
    return device


# --- the relay ---


def _relay(near: int, far: int, case: Case, over: int, told: int) -> None:
    """Pass packets between two devices until ``over`` is readable; say how many on ``told``."""
    chance, other = random.Random(case.seed), {near: far, far: near}
    queues: dict[int, deque[bytes]] = {near: deque(), far: deque()}
    free_s = {near: 0.0, far: 0.0}
    dropped = passed = 0
    while True:
        now_s = time.monotonic()
        waits = [free_s[to] - now_s for to, queue in queues.items() if queue]
        ready, _, _ = select.select([near, far, over], [], [], max(0.0, min(waits)) if waits else None)
        if over in ready:
            os.write(told, json.dumps({"dropped": dropped, "passed": passed}).encode())
            return
        for device in ready:
            packet = os.read(device, 65536)
            if chance.random() < case.loss:
                dropped += 1
            elif len(queues[other[device]]) < _QUEUED:
                queues[other[device]].append(packet)
        for to, queue in queues.items():
            while queue and free_s[to] <= time.monotonic():
                packet = queue.popleft()
                passed += 1
                if case.rate_mbit_s:
                    free_s[to] = max(free_s[to], time.monotonic()) + 8e-6 * len(packet) / case.rate_mbit_s
                os.write(to, packet)


# --- the two sides ---


def _near(case: Case) -> None:
    from two_sides import Sender  # noqa: PLC0415 - the relay needs none of it

    ours, theirs = socket.socketpair()
    far = subprocess.Popen(
        ["unshare", "-n", sys.executable, __file__, "far", str(theirs.fileno())],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, pass_fds=[theirs.fileno()], text=True,
    )  # fmt: skip
    theirs.close()
    device = _tun(_NEAR)
    _, (their_device,), _, _ = socket.recv_fds(ours, 16, 1)
    over, end = os.pipe()
    report, told = os.pipe()
    if os.fork() == 0:
        os.close(end)
        _relay(device, their_device, case, over, told)
        os._exit(0)
    assert far.stdin
    assert far.stdout
    with Sender(_ENDPOINT) as sender:
        print("go", file=far.stdin, flush=True)
        assert far.stdout.readline() == "ready\n"
        sender.await_receiver()
        sent = sender.send(truth=case.truth, frame_hz=case.frame_hz)
        print(json.dumps(sent), file=far.stdin, flush=True)
        arrived = json.loads(far.stdout.readline())
        far.wait()
    os.close(end)
    _say(json.dumps(arrived | {"frames_sent": sent["frames"]} | json.loads(os.read(report, 4096))))


def _far(link: int) -> None:
    with socket.socket(fileno=link) as theirs:
        socket.send_fds(theirs, [b"tun"], [_tun(_FAR)])
    from two_sides import Receiver  # noqa: PLC0415 - after the device is there

    sys.stdin.readline()
    with Receiver(_ENDPOINT) as receiver:
        _say("ready")
        _say(json.dumps(receiver.receive(json.loads(sys.stdin.readline()))))


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    match sys.argv[1]:
        case "try":
            os.close(_tun(_NEAR))
        case "near":
            _near(Case(**json.loads(sys.argv[2])))
        case "far":
            _far(int(sys.argv[2]))
