"""Whether a log's record of completeness is true, whoever ends: it is compared with the publisher's count."""

import json
import secrets
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest
from bus_processes import BusProcess, publisher_process, router_process
from facility_process import until
from live_bus import Bus, daemon
from logger_desk import completeness, metadata, read

from rpod_logger.daemon import run
from rpod_runtime import QueryFailedError
from rpod_runtime.bus.session import open_client
from rpod_schemas.config.facility.logger import LoggerConfig
from rpod_schemas.config.service import BusConfig
from rpod_schemas.control import LogReply, StatusReply
from rpod_schemas.logs import BUS
from rpod_schemas.messages import write_clock
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.rmw.wire import Attachment, GraphNode, publisher_tokens, session_of_token
from rpod_schemas.topics import CLOCK, DIAGNOSTICS


class Scene:
    """A publisher as a process, a logger here, and one more client that asks."""

    def __init__(self, endpoint: str, directory: Path, stack: ExitStack) -> None:
        namespace = f"n{secrets.token_hex(4)}"
        self.config = BusConfig(connect=endpoint, namespace=namespace)
        self.path = directory / "run.mcap"
        self._logger = stack.enter_context(ExitStack())
        config = LoggerConfig(bus=self.config, directory=directory, name="run")
        self._logger.enter_context(daemon(run, config))
        self.asker = Bus(endpoint, stack).node("asker", namespace=namespace)
        self.publisher: BusProcess = stack.enter_context(publisher_process(self.config))
        until(lambda: self.counter("written/clock") > 50)

    def counter(self, name: str, instance: str = "logger") -> int:
        try:
            return self.asker.ask(instance, "status", StatusReply, timeout_s=1.0).counters.get(name, 0)
        except QueryFailedError:
            return 0

    def close_log(self) -> None:
        self._logger.close()

    @property
    def logged(self) -> int:
        return sum(topic.endswith("/clock") for topic, _ in read(self.path))


@pytest.fixture
def scene(endpoint: str, tmp_path: Path) -> Iterator[Scene]:
    with ExitStack() as stack:
        yield Scene(endpoint, tmp_path, stack)


@pytest.fixture
def router() -> Iterator[tuple[BusProcess, str]]:
    with router_process() as process:
        yield process


@pytest.fixture
def scene_of_its_own(router: tuple[BusProcess, str], tmp_path: Path) -> Iterator[Scene]:
    """A scene whose router may be killed."""
    with ExitStack() as stack:
        yield Scene(router[1], tmp_path, stack)


def test_a_publisher_that_ends_in_order_leaves_a_complete_log(scene):
    published = scene.publisher.end(signal.SIGTERM)
    scene.close_log()
    assert completeness(scene.path).reasons == ()
    assert scene.logged == published


def test_a_log_that_is_closed_while_its_publisher_goes_on_is_complete(scene):
    published = scene.publisher.published
    scene.close_log()
    assert completeness(scene.path).reasons == ()
    assert scene.logged >= published
    assert scene.publisher.end(signal.SIGTERM) > published


@pytest.mark.parametrize("wait_s", [0.0, 1.3], ids=["closed at once", "closed later"])
def test_a_publisher_that_was_killed_makes_the_log_incomplete(scene, wait_s):
    published = scene.publisher.end(signal.SIGKILL)
    scene.asker.stop.wait(wait_s)
    scene.close_log()
    (reason,) = completeness(scene.path).reasons
    assert reason.startswith("publisher (session ")
    assert "without saying its last numbers" in reason
    assert published - 250 < scene.logged <= published + 1  # the last one may not have been counted


def test_a_publisher_that_hangs_at_the_close_makes_the_log_incomplete(scene):
    scene.publisher.suspend()
    scene.close_log()
    scene.publisher.send(signal.SIGCONT)
    (reason,) = completeness(scene.path).reasons
    assert "did not answer at the close" in reason


def test_only_the_file_in_which_a_publisher_was_killed_is_incomplete(scene):
    second = scene.asker.ask("logger", "split", LogReply).path
    scene.publisher.end(signal.SIGKILL)
    third = scene.asker.ask("logger", "split", LogReply).path
    scene.close_log()
    stated = [completeness(path) for path in (scene.path, second, third)]
    assert [each.complete for each in stated] == [True, False, True]
    assert [each.continues for each in stated] == [None, "run.mcap", "run_0002.mcap"]


def test_a_token_that_somebody_declares_in_a_publishers_name_hides_no_kill(scene):
    keys = scene.config.keys
    with closing(open_client(scene.config)) as liar:
        pattern = publisher_tokens(keys, CLOCK)
        (reply,) = until(lambda: list(liar.liveliness().get(pattern)))
        victim = session_of_token(str(reply.ok.key_expr))
        for entity in range(90, 93):
            token = GraphNode(keys, victim, "liar").endpoint_token("MP", entity, DIAGNOSTICS)
            liar.liveliness().declare_token(token).undeclare()
        scene.asker.stop.wait(1.5)
        second = scene.asker.ask("logger", "split", LogReply).path
        scene.publisher.end(signal.SIGKILL)
        scene.close_log()
    assert completeness(scene.path).reasons == ()
    (reason,) = completeness(second).reasons
    assert "without saying its last numbers" in reason


def test_a_router_that_was_killed_makes_the_log_incomplete(scene_of_its_own, router, caplog):
    scene, killed_ns = scene_of_its_own, time.time_ns()
    router[0].end(signal.SIGKILL)
    until(lambda: scene.asker.link.lost)
    scene.close_log()
    closed_ns = time.time_ns()
    assert [record for record in caplog.records if record.getMessage().startswith("bus lost")]
    stated = completeness(scene.path)
    assert "the bus was lost: since " in stated.reasons[0]
    (outage,) = json.loads(metadata(scene.path, BUS)["outages"])
    assert outage["end_ns"] is None
    assert killed_ns <= outage["begin_ns"] <= closed_ns
    assert scene.publisher.end(signal.SIGTERM) > scene.logged


def test_an_outage_is_told_by_log_and_diagnostics_after_its_end(scene_of_its_own, router, caplog):
    scene = scene_of_its_own
    router[0].close()
    until(lambda: scene.asker.link.lost)
    with router_process(router[1]):
        until(lambda: not scene.asker.link.lost)
        until(lambda: scene.counter("bus/lost") == 1)
        until(lambda: scene.counter("bus/lost", "publisher") == 1)
        received = scene.counter("received/clock")
        until(lambda: scene.counter("received/clock") > received)
        published = scene.publisher.end(signal.SIGTERM)
        scene.close_log()
    assert [record for record in caplog.records if record.getMessage().startswith("bus regained")]
    stated = completeness(scene.path)
    assert not stated.complete
    assert any(reason.startswith("the bus was lost: ") and " to " in reason for reason in stated.reasons)
    assert not any("last numbers" in reason for reason in stated.reasons), "the publisher came back and ended"
    assert scene.logged <= published


def test_a_publisher_of_other_software_says_no_last_number_and_this_is_told(scene):
    session = open_client(scene.config)
    keys = scene.config.keys
    graph = GraphNode(keys, str(session.zid()), "foreign")
    token = session.liveliness().declare_token(graph.endpoint_token("MP", 1, CLOCK))
    received = scene.counter("received/clock")
    attachment = Attachment(7, time.time_ns(), secrets.token_bytes(16)).pack()
    session.put(keys.key(CLOCK), bytes(encode(write_clock(7))), attachment=attachment)
    until(lambda: scene.counter("received/clock") > received)
    token.undeclare()
    session.close()
    scene.asker.stop.wait(1.5)
    scene.close_log()
    assert completeness(scene.path).complete
    (told,) = json.loads(metadata(scene.path, BUS)["unconfirmed"])
    assert told.startswith("clock: a publisher of session ")
