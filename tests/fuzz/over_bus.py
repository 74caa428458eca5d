"""Hostile messages and queries over the bus, with the whole facility up as processes.

Afterwards every process still runs, the target is tracked again, and the log is closed.
"""

import secrets
import signal
import time
from collections import Counter
from contextlib import closing
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from threading import Event

import zenoh
from facility_process import FacilityProcess
from fuzz.mutation import mutate_message
from fuzz.seeds import messages
from fuzz.subjects import subjects
from live_bus import first

from rpod_runtime import Inbox, Node, Received
from rpod_runtime.bus.session import open_client
from rpod_schemas.config.service import BusConfig, RouterConfig, ServiceConfig
from rpod_schemas.messages import read_status
from rpod_schemas.rmw.wire import GID_BYTES, Attachment
from rpod_schemas.topics import STATUS, Topic
from rpod_schemas.types import Mode

SCENARIO = "mockup-tumbling"
TRACKING_S = 2.0
"""Longest time from the last hostile message to an estimate."""
_RATE_HZ = 500.0
_QUERIES = (
    ("estimator", "reset", "ResetRequest", False),  # it accepts the newest mount, which may be a hostile one
    ("logger", "split", "LogRequest", True),
    ("motion", "start", "StartRequest", False),
    ("emulator", "fault", "FaultRequest", False),
)
"""Instance, verb, request, and whether the run goes on as before if it is accepted."""


def fuzz_facility(budget_s: float, seed: int) -> Counter[str]:
    """Send hostile messages and queries for so long; return what was found."""
    found, rnd = Counter[str](), Random(f"{seed}/bus")
    with TemporaryDirectory() as folder:
        arguments = SCENARIO, "--duration", f"{budget_s + 600.0:.0f}"
        with closing(FacilityProcess(*arguments, out=Path(folder) / "runs")) as run:
            run.await_playing()
            config = (run.directory / "config" / "router.json").read_text("utf-8")
            bus = BusConfig(connect=RouterConfig.model_validate_json(config).listen)
            with Node(ServiceConfig(instance="watcher", bus=bus), version="fuzz", stop=Event()) as node:
                statuses = Inbox()
                node.subscribe(STATUS, statuses.put)
                assert first(statuses, _tracks, 60.0), "not tracked before anything hostile was sent"
                before_mib = _memory_mib(run)
                sent = _Hostile(bus, rnd).send(budget_s)
                ended_s = time.monotonic()
                statuses.wait(0.0)
                if not first(statuses, _tracks, 30.0):
                    found["over the bus: not tracked again within 30 s"] += 1
                elif (took_s := time.monotonic() - ended_s) > TRACKING_S:
                    found[f"over the bus: tracked again only after {took_s:.1f} s"] += 1
            for name, process in run.services.items():
                if not process.is_running():
                    found[f"over the bus: {name} has ended"] += 1
            for name, mib in _memory_mib(run).items():
                print(
                    f"over the bus: memory of {name} {before_mib.get(name, 0.0):.0f} MiB, then {mib:.0f} MiB"
                )
            run.send(signal.SIGINT)
            if run.wait() != 130 or run.left():
                found["over the bus: the run does not end in order"] += 1
            print(f"over the bus: {sent} messages and queries")
            for log in (run.directory / "logs").iterdir():
                found[f"over the bus: a traceback in {log.name}"] += "Traceback" in log.read_text(
                    "utf-8", "replace"
                )
    return +found


def _memory_mib(run: FacilityProcess) -> dict[str, float]:
    """Return the resident memory of each service that runs, MiB."""
    return {
        name: process.memory_info().rss / 2**20
        for name, process in run.services.items()
        if process.is_running()
    }


def _tracks(received: Received) -> bool:
    return read_status(received.decode()).mode == Mode.TRACKING


class _Hostile:
    """Sends mutants of valid messages, under gids of its own and, rarely, without a usable attachment."""

    def __init__(self, bus: BusConfig, rnd: Random) -> None:
        self._bus, self._rnd, self._sequence = bus, rnd, Counter[Topic]()
        self._gids = {topic: secrets.token_bytes(GID_BYTES) for topic in messages()}

    def send(self, budget_s: float) -> int:
        """Send at ``_RATE_HZ`` at most; return how many messages and queries were sent."""
        sent, begin_s, pause = 0, time.monotonic(), Event()
        with closing(open_client(self._bus)) as session:
            while (ran_s := time.monotonic() - begin_s) < budget_s:
                topic = self._rnd.choice(list(messages()))
                payload = mutate_message(self._rnd, messages()[topic], topic.type)
                session.put(self._bus.keys.key(topic), payload, attachment=self._attachment(topic))
                sent += 1
                if sent % 500 == 0:
                    sent += self._ask(session)
                pause.wait(max(0.0, sent / _RATE_HZ - ran_s))
        return sent

    def _attachment(self, topic: Topic) -> bytes:
        self._sequence[topic] += 1
        if self._rnd.randrange(20) == 0:
            return subjects()["attachment"].make(self._rnd)
        gid = secrets.token_bytes(GID_BYTES) if self._rnd.randrange(20) == 0 else self._gids[topic]
        return Attachment(self._sequence[topic], time.time_ns(), gid).pack()

    def _ask(self, session: zenoh.Session) -> int:
        """Ask for something that is refused, or that leaves the run as it is."""
        instance, verb, request, harmless = self._rnd.choice(_QUERIES)
        subject = subjects()[f"query {request}"]
        payload = subject.make(self._rnd)
        if not harmless and subject.read(payload):
            return 0
        list(session.get(self._bus.keys.control(instance, verb), payload=payload, timeout=2.0))
        return 1
