"""Checks of the machine alone: clock, versions, ports, disk, memory, descriptors."""

import ctypes
import os
import platform
import resource
import shutil
import socket
import time
from collections.abc import Iterator
from importlib.metadata import requires, version
from pathlib import Path
from tempfile import TemporaryFile

from rpod import __version__
from rpod.doctor.finding import CAMERA_MB_S, Finding, Level

_CLOCK_ERROR_S = 0.002
"""Error of a clock that does not matter, s: at 5 deg/s it changes the attitude by 0.01 deg."""
_DISK_BYTES, _BLOCK_BYTES = 128 << 20, 1 << 20
_FREE_BYTES = 10 << 30
_MEMORY_BYTES = 4 << 30
_DESCRIPTORS = 1024
_LEAST_PYTHON, _NO_PYTHON = (3, 11), (3, 14)
_TIME_ERROR = 5
"""Return value of adjtimex(2) for a clock that nothing synchronises."""


def versions() -> Iterator[Finding]:
    """Compare Python and Zenoh with what this version of rpod needs."""
    python = platform.python_version_tuple()
    known = _LEAST_PYTHON <= (int(python[0]), int(python[1])) < _NO_PYTHON
    yield Finding(
        "python", Level.OK if known else Level.FAIL, f"{platform.python_version()} for rpod {__version__}",
        "" if known else "install Python 3.11, 3.12 or 3.13",
    )  # fmt: skip
    installed = version("eclipse-zenoh")
    pinned = next((each for each in requires("rpod") or () if each.startswith("eclipse-zenoh==")), "")
    needed = pinned.partition("==")[2].split(";")[0].strip()
    same = not needed or installed == needed
    yield Finding(
        "zenoh", Level.OK if same else Level.FAIL, f"{installed} is installed, {needed or 'any'} is needed",
        "" if same else f"pip install eclipse-zenoh=={needed}",
    )  # fmt: skip


class _Timex(ctypes.Structure):
    """The beginning of ``struct timex`` of adjtimex(2), with room for the rest."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("rest", ctypes.c_char * 256),
    )


def clock() -> Finding:
    """Ask the kernel whether its clock is synchronised, and how well."""
    told = _Timex()
    try:
        state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(told))
    except AttributeError:
        return Finding("clock", Level.UNCHECKED, "this system has no adjtimex", "check its time service")
    if state < 0:
        return Finding(
            "clock", Level.UNCHECKED, f"adjtimex: {os.strerror(ctypes.get_errno())}",
            "run the doctor on the host itself, not in a container that may not read the clock's state",
        )  # fmt: skip
    return check_clock(state == _TIME_ERROR, told.esterror / 1e6, told.maxerror / 1e6)


def check_clock(unsynchronised: bool, error_s: float, most_s: float) -> Finding:
    """Check a clock by the kernel's own estimate of its error, and by its bound."""
    if unsynchronised:
        return Finding(
            "clock", Level.FAIL, "the kernel says that nothing synchronises it",
            "run chrony, or ptp4l and phc2sys where sensors keep PTP's time; in a container, on its host",
        )  # fmt: skip
    text = f"synchronised, off by {1e3 * error_s:.3f} ms by its own estimate, {1e3 * most_s:.1f} ms at most"
    if error_s > _CLOCK_ERROR_S:
        return Finding(
            "clock", Level.NOTE, text,
            f"for sensors on another host than the estimator below {1e3 * _CLOCK_ERROR_S:g} ms are needed: "
            "use PTP, or a time server in the laboratory",
        )  # fmt: skip
    return Finding("clock", Level.OK, text)


def room() -> Iterator[Finding]:
    """Look at memory and at the limit of open descriptors."""
    available = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    enough = available >= _MEMORY_BYTES
    yield Finding(
        "memory", Level.OK if enough else Level.NOTE, f"{available / 2**30:.1f} GiB are free",
        "" if enough else "the estimator of a large target may need 4 GiB",
    )  # fmt: skip
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    enough = soft == resource.RLIM_INFINITY or soft >= _DESCRIPTORS
    yield Finding(
        "descriptors", Level.OK if enough else Level.FAIL, f"a process may open {soft}",
        "" if enough else "raise the limit: ulimit -n 8192, or LimitNOFILE= of the unit",
    )  # fmt: skip


def disk(directory: Path) -> Iterator[Finding]:
    """Measure free space, and the rate of writing with a sync at the end, where the logs go."""
    check = f"disk {directory}"
    place = next((each for each in (directory, *directory.absolute().parents) if each.is_dir()), Path("/"))
    free = shutil.disk_usage(place).free
    hours = free / (CAMERA_MB_S * 1e6) / 3600.0
    enough = free >= _FREE_BYTES
    yield Finding(
        check, Level.OK if enough else Level.FAIL,
        f"{free / 1e9:.1f} GB are free: {hours:.1f} h of a camera at 45 Hz, uncompressed",
        "" if enough else "make room, or set the logger's directory to another disk",
    )  # fmt: skip
    if free < 2 * _DISK_BYTES:
        return
    block = os.urandom(_BLOCK_BYTES)
    try:
        with TemporaryFile(dir=place) as file:
            began_s = time.perf_counter()
            for _ in range(_DISK_BYTES // _BLOCK_BYTES):
                file.write(block)
            file.flush()
            os.fsync(file.fileno())
            took_s = time.perf_counter() - began_s
    except OSError as error:
        remedy = "give the logger's user the right to write there"
        yield Finding(check, Level.FAIL, f"cannot be written: {error}", remedy)
        return
    yield check_disk(check, _DISK_BYTES / 1e6 / took_s)


def check_disk(check: str, rate_mb_s: float) -> Finding:
    """Compare a disk's rate with that of a camera."""
    text = f"writes {rate_mb_s:.0f} MB/s; a camera at 45 Hz sends {CAMERA_MB_S:.0f}, with raw samples 109"
    if rate_mb_s < CAMERA_MB_S:
        return Finding(check, Level.FAIL, text, "log to a faster disk, or lower rate or resolution")
    if rate_mb_s < 3.0 * CAMERA_MB_S:
        return Finding(check, Level.NOTE, text, "do not record raw samples on this disk")
    return Finding(check, Level.OK, text)


def port(endpoint: str, *, reachable: bool) -> Finding:
    """Tell whether a router can listen on an endpoint, or already does."""
    check = f"port {endpoint}"
    if reachable:
        return Finding(check, Level.OK, "a router answers there")
    protocol, _, address = endpoint.partition("/")
    host, _, number = address.rpartition(":")
    if protocol not in ("tcp", "tls", "quic") or not number.isdigit():
        return Finding(check, Level.UNCHECKED, "no address with a port")
    kind = socket.SOCK_DGRAM if protocol == "quic" else socket.SOCK_STREAM
    try:
        found = socket.getaddrinfo(host.strip("[]") or None, int(number), type=kind)[0]
        with socket.socket(found[0], kind) as probe:
            if kind == socket.SOCK_STREAM:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(found[4])
    except (OSError, OverflowError) as error:
        return Finding(
            check, Level.FAIL, f"no router answers there, and none can listen: {error}",
            "end what uses the port (ss -lntup shows it), or give the router another endpoint",
        )  # fmt: skip
    return Finding(check, Level.OK, "free; a router can listen there")
