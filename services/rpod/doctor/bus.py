"""Checks over the bus: delay and rate of the link to the router, versions of services, a second router."""

import time
from collections.abc import Iterator
from contextlib import ExitStack
from secrets import token_hex
from threading import Event

import zenoh

from rpod import __version__
from rpod.doctor.finding import CAMERA_FRAME_BYTES, CAMERA_HZ, Finding, Level
from rpod_runtime.bus.session import open_client
from rpod_runtime.process.awake import AwakeClock
from rpod_runtime.requests.asker import Asker
from rpod_runtime.requests.identity import open_identity
from rpod_schemas.config.service import BusConfig, ServiceConfig

_PINGS = 30
_BLOCK_BYTES = 4 << 20
_BLOCKS = 4
_TIMEOUT_S = 10.0
_SEEN_S = 3.0
"""Longest time until two routers have exchanged their declarations, s."""


class Visitor(Asker):
    """A client without topics of its own: it leaves nothing in a log."""

    def __init__(self, session: zenoh.Session, bus: BusConfig) -> None:
        self.stop = Event()
        self._session, self._keys = session, bus.keys
        self._secure = bus.credentials is not None
        self._identity = open_identity(ServiceConfig(instance=_instance(bus), bus=bus))

    def versions(self) -> Iterator[Finding]:
        """Compare the versions of the services on the bus with this one."""
        told = self.ask_all()
        if not told and self._secure:
            yield Finding(
                "services", Level.UNCHECKED, f"none answers to {self._identity.name}",
                "if some run: give bus.credentials of an operator, who may ask all for their status",
            )  # fmt: skip
        elif not told:
            yield Finding("services", Level.OK, "none is on the bus")
        for each in sorted(told, key=lambda reply: reply.name):
            same = each.version == __version__
            yield Finding(
                f"service {each.name}", Level.OK if same else Level.FAIL,
                f"{each.state}, rpod {each.version}; here is {__version__}",
                "" if same else "install the same version on both hosts, then start the service again",
            )  # fmt: skip


def _instance(bus: BusConfig) -> str:
    """Return the name by which the doctor asks; on a secure bus its certificate states it."""
    if bus.credentials is None:
        return "doctor"
    from rpod_security.credentials import Credentials  # noqa: PLC0415 - of an extra

    return Credentials.read(bus.credentials).identity.name


def link(bus: BusConfig) -> Iterator[Finding]:
    """Measure the link to the router, and ask what is on the bus.

    Raises:
        NoRouterError: no router answers.
        CredentialsError: the folder of credentials cannot be used.
    """
    with ExitStack() as stack:
        asker, answerer = (stack.enter_context(open_client(bus)) for _ in range(2))
        key = bus.keys.control(f"doctor-{token_hex(4)}", "echo")
        _declare_echo(stack, answerer, key)
        yield _measure(asker, key, bus.connect)
        yield from Visitor(asker, bus).versions()


def routers(bus: BusConfig, other: str) -> Finding:
    """Ask through one router for what is declared at another one. Raises ``NoRouterError``."""
    with ExitStack() as stack:
        here = stack.enter_context(open_client(bus))
        there = stack.enter_context(open_client(bus.model_copy(update={"connect": other})))
        key = bus.keys.control(f"doctor-{token_hex(4)}", "echo")
        _declare_echo(stack, there, key)
        check = f"router {other}"
        delay_s = _first_delay_s(here, key)
        if delay_s is None:
            return Finding(
                check, Level.FAIL, f"{bus.connect} does not see what is declared there after {_SEEN_S:g} s",
                "let one of the two routers connect to the other, by 'connect' in its configuration",
            )  # fmt: skip
        return Finding(check, Level.OK, f"{bus.connect} sees it; an answer takes {1e3 * delay_s:.1f} ms")


def _declare_echo(stack: ExitStack, session: zenoh.Session, key: str) -> None:
    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(key, query.payload or b"")

    stack.callback(session.declare_queryable(key, answer).undeclare)


def _delay_s(session: zenoh.Session, key: str, payload: bytes, timeout_s: float) -> float | None:
    began_s = time.perf_counter()
    for answer in session.get(key, payload=payload, timeout=timeout_s):
        if answer.ok is not None and len(answer.ok.payload) == len(payload):
            return time.perf_counter() - began_s
    return None


def _first_delay_s(session: zenoh.Session, key: str) -> float | None:
    """Return the time of the first answer, once the queryable is known; None if it never is."""
    clock = AwakeClock()
    while clock.now_s() < _SEEN_S:
        delay_s = _delay_s(session, key, b".", 1.0)
        if delay_s is not None:
            return delay_s
        time.sleep(0.05)  # a query without a queryable returns at once
    return None


def _measure(session: zenoh.Session, key: str, endpoint: str) -> Finding:
    check = f"link {endpoint}"
    if _first_delay_s(session, key) is None:
        return Finding(
            check, Level.UNCHECKED, "a query is not answered",
            "on a secure bus only clients with a role may answer queries: there the link cannot be measured",
        )  # fmt: skip
    pings = sorted(filter(None, (_delay_s(session, key, b".", _TIMEOUT_S) for _ in range(_PINGS))))
    block = bytes(_BLOCK_BYTES)
    times_s = [_delay_s(session, key, block, _TIMEOUT_S) for _ in range(_BLOCKS)]
    if not pings or None in times_s:
        return Finding(
            check, Level.FAIL, f"{_BLOCK_BYTES >> 20} MiB are not echoed within {_TIMEOUT_S:g} s",
            "check the network: ethtool, and ping with large packets",
        )  # fmt: skip
    # each echo crosses the link twice in each direction, as query and as answer
    rate = 2.0 * _BLOCK_BYTES * _BLOCKS / sum(filter(None, times_s))
    return check_link(check, pings[len(pings) // 2], rate)


def check_link(check: str, delay_s: float, bytes_s: float) -> Finding:
    """Check a link by the frames of a camera that it carries."""
    frames_hz = bytes_s / CAMERA_FRAME_BYTES
    text = (
        f"answers after {1e3 * delay_s:.1f} ms, carries at least {bytes_s / 1e6:.1f} MB/s each way: "
        f"{frames_hz:.1f} frames/s of a camera of 352 x 287 pixels"
    )
    if frames_hz < 1.0:
        return Finding(check, Level.FAIL, text, "run the estimator and the logger on the sensor's host")
    if frames_hz < CAMERA_HZ:
        return Finding(
            check, Level.NOTE, text,
            "for faster cameras, lower rate or resolution, or run the estimator on the sensor's host",
        )  # fmt: skip
    return Finding(check, Level.OK, text)
