"""Two hosts with a router each on a secure bus: the link passes what the members need, and nothing else."""

import json
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from threading import Event, Thread

import pytest
import zenoh
from facility_process import until
from live_bus import TIMEOUT_S, first
from secure_bus import KEYS, members

from rpod_runtime import Inbox, Node, QueryFailedError
from rpod_runtime.bus.session import free_endpoint, open_client, open_router
from rpod_schemas.config.service import BusConfig, RouterConfig, ServiceConfig
from rpod_schemas.control import Accepted, Empty
from rpod_schemas.topics import ESTIMATE, STATUS, TF, TRUTH, TRUTH_TOPICS
from rpod_security.authority import Authority
from rpod_security.facility import named
from rpod_security.roles import topics_of
from rpod_security.rules import OtherHost, Rules

CONTROL = frozenset({"estimator", "operator", "guidance"})
"""Members of the second host; the others are beside the sensors."""
HOSTS = ("localhost", "127.0.0.1")
PAYLOAD = b"\0\1\0\0x"
DENIED = [topic for topic in TRUTH_TOPICS if topic != TF]
"""Estimates are on ``tf`` too, and the operator reads it."""


class Hosts:
    """Two joined routers, each with the rules of its own members and of its link."""

    def __init__(self, folder: Path) -> None:
        self.pki = folder / "pki"
        self.authority = Authority.create(self.pki)
        for name in ("sensors-router", "control-router"):
            self.authority.issue("router", name, hosts=HOSTS)
        self.authority.issue("link", "control-link")
        for member in members():
            self.authority.issue(member.role, member.name)
        self.sensors, self.control = (free_endpoint().replace("tcp/", "tls/") for _ in range(2))
        here = frozenset(member.name for member in members()) - CONTROL
        self._rules = {
            "sensors": self._write(folder / "sensors.json", CONTROL, "control-link"),
            "control": self._write(folder / "control.json", here, "sensors-router"),
        }

    def _write(self, file: Path, far: frozenset[str], peer: str) -> Path:
        identities = {entry.name: entry.identity for entry in self.authority.valid}
        other = OtherHost(far, (identities[peer].common_name,))
        rules = Rules(KEYS, members())
        file.write_text(json.dumps(rules.access_control(named(rules, identities.values()), other)), "utf-8")
        return file

    def open_sensors(self) -> zenoh.Session:
        return open_router(
            RouterConfig(
                listen=self.sensors,
                credentials=self.pki / "sensors-router",
                rules=self._rules["sensors"],
                estimators=(),
            )
        )

    def open_control(self, link: str = "control-link") -> zenoh.Session:
        return open_router(
            RouterConfig(
                listen=self.control,
                connect=(self.sensors,),
                credentials=self.pki / "control-router",
                link_credentials=self.pki / link,
                rules=self._rules["control"],
                estimators=(),
            )
        )

    def bus(self, name: str) -> BusConfig:
        endpoint = self.control if name in CONTROL else self.sensors
        return BusConfig(connect=endpoint, credentials=self.pki / name)

    def node(self, name: str) -> Node:
        return Node(ServiceConfig(instance=name, bus=self.bus(name)), version="test")


@pytest.fixture(scope="module")
def hosts(tmp_path_factory) -> Iterator[Hosts]:
    hosts = Hosts(tmp_path_factory.mktemp("hosts"))
    with ExitStack() as stack:
        stack.enter_context(hosts.open_control())
        stack.enter_context(hosts.open_sensors())
        yield hosts


@contextmanager
def publishing(*publishers) -> Iterator[None]:
    """Publish again and again, until what comes of it is known."""
    over = Event()

    def publish() -> None:
        while not over.wait(0.02):
            for publisher in publishers:
                publisher.put(PAYLOAD)

    thread = Thread(target=publish)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def test_frames_estimates_and_commands_pass_the_link_and_the_truth_does_not(hosts: Hosts):
    with ExitStack() as stack:
        names = ("motion", "emulator", "logger", "estimator", "operator")
        motion, emulator, logger, estimator, operator = (
            stack.enter_context(hosts.node(name)) for name in names
        )
        frames = next(topic for topic in members_topics("emulator") if topic.name == "pmd/depth/image_raw")
        to_estimator, to_logger, truth, denied = Inbox(), Inbox(), Inbox(), Inbox()
        estimator.subscribe(frames, to_estimator.put, recover=True, history=True)
        logger.subscribe(ESTIMATE, to_logger.put, recover=True, history=True)
        logger.subscribe(TRUTH, truth.put)
        for node in (estimator, operator):
            node.subscribe(TRUTH, denied.put, recover=True, history=True)
        done = []
        estimator.serve("reset", Empty, lambda _: done.append(1) or Accepted())
        emulator.serve("start", Empty, lambda _: done.append(2) or Accepted())
        publishers = emulator.publisher(frames), estimator.publisher(ESTIMATE), motion.publisher(TRUTH)
        with publishing(*publishers):
            for inbox in (to_estimator, to_logger, truth):
                assert first(inbox, bool)
        assert until(lambda: answered(operator, "emulator", "start")), "a command across the link"
        assert until(lambda: answered(operator, "estimator", "reset"))
        assert {1, 2} <= set(done)
        assert denied.wait(0.0) == []


def members_topics(name: str):
    (member,) = (each for each in members() if each.name == name)
    return [topic for sensor in member.sensors for topic in topics_of(sensor)]


def answered(node: Node, service: str, verb: str) -> bool:
    try:
        return node.ask(service, verb, Accepted, timeout_s=TIMEOUT_S).accepted
    except QueryFailedError:
        return False


def test_a_host_forges_nothing_of_the_other_and_reads_no_truth_by_any_expression(hosts: Hosts):
    """Rights are those of the members there: the link gives none of its own, in both directions."""
    with ExitStack() as stack:
        motion, logger = (stack.enter_context(open_client(hosts.bus(name))) for name in ("motion", "logger"))
        # somebody on the control host whose router lets everything pass: the link's certificate itself
        broken = stack.enter_context(
            open_client(BusConfig(connect=hosts.sensors, credentials=hosts.pki / "control-link"))
        )
        heard, forged, seen = set(), set(), Event()
        for topic in DENIED:
            for asked in (KEYS.key(topic), "**", f"{KEYS.key(topic)}/@adv/**"):
                stack.callback(
                    broken.declare_subscriber(asked, lambda s: heard.add(s.payload.to_string())).undeclare
                )
            stack.callback(
                logger.declare_subscriber(
                    KEYS.key(topic), lambda s: forged.add(s.payload.to_string())
                ).undeclare
            )

        def take(sample: zenoh.Sample) -> None:
            if sample.payload.to_string() == "estimator's":
                seen.set()

        stack.callback(logger.declare_subscriber(KEYS.key(STATUS), take).undeclare)
        for _ in range(1200):
            for topic in DENIED:
                motion.put(KEYS.key(topic), "true")
                broken.put(KEYS.key(topic), "forged")
            broken.put(KEYS.key(STATUS), "estimator's")  # what its side may send
            if seen.wait(0.05) and forged:
                break
        assert seen.is_set()
        assert forged == {"true"}
        assert "true" not in heard, "a session hears what it sends itself, and nothing else"


def test_a_router_without_the_links_certificate_joins_nothing(hosts: Hosts, tmp_path: Path):
    stranger = Hosts(tmp_path)
    stranger.sensors = hosts.sensors  # another authority's
    with ExitStack() as stack:
        stack.enter_context(stranger.open_control())
        with stranger.node("estimator") as estimator, hosts.node("logger") as logger:
            inbox = Inbox()
            logger.subscribe(ESTIMATE, inbox.put)
            publisher = estimator.publisher(ESTIMATE)
            for _ in range(20):
                publisher.put(PAYLOAD)
                assert not first(inbox, bool, 0.05)
