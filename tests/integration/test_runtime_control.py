"""The control plane, and how a node finds its router, or says that there is none."""

import json
import logging
import re
from threading import Event, Thread, Timer
from time import monotonic

import pytest
import zenoh
from facility_process import until
from live_bus import TIMEOUT_S, collect, first, router

from rpod_runtime import Inbox, NoRouterError, QueryFailedError
from rpod_runtime.bus.session import free_endpoint, open_client, open_router
from rpod_runtime.errors import EndpointError, LockstepError, RefusedError
from rpod_runtime.node import Node
from rpod_runtime.process.lifecycle import EXIT_FAILURE, EXIT_OK, EXIT_USAGE, run
from rpod_schemas.config.service import BusConfig, RouterConfig, ServiceConfig
from rpod_schemas.control import (
    Accepted,
    Empty,
    ErrorReply,
    FaultRequest,
    LogReply,
    ResetRequest,
    StatusReply,
)
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.messages import read_diagnostics, write_clock
from rpod_schemas.topics import CLOCK, DIAGNOSTICS, Namespace

KEYS = Namespace()


def config(endpoint: str, **bus: object) -> ServiceConfig:
    return ServiceConfig(instance="late", bus=BusConfig(connect=endpoint, **bus))


def answers(session: zenoh.Session, key: str, payload: bytes = b"") -> list[zenoh.Reply]:
    """Query until somebody answers: a client that has just connected may not know the services yet."""
    return until(lambda: list(session.get(key, payload=payload or None, timeout=2.0)))


# --- queries ---


def test_a_service_says_what_it_is(bus):
    server, asker = bus.node("server"), bus.node("asker")
    server.health.count("frames/pmd", 3)
    server.target_digest = "abc"
    server.ready("at work")
    status = asker.ask("server", "status", StatusReply)
    assert (status.name, status.version, status.state) == ("server", "test", "ready")
    assert status.counters["frames/pmd"] == 3
    assert status.configuration["bus"]["connect"] == bus.endpoint
    assert status.target_digest == "abc"


def test_a_query_waits_until_a_service_that_starts_is_known(bus):
    asker, server = bus.node("asker"), bus.node("server")
    late = Timer(0.3, server.serve, ("reset", ResetRequest, lambda _: Accepted()))
    late.start()
    assert asker.ask("server", "reset", Accepted, ResetRequest()).accepted
    late.join()


def test_a_command_that_was_accepted_is_in_the_diagnostics_and_one_that_was_refused_is_not(bus):
    def inject(request: FaultRequest) -> Accepted:
        if request.duration_s > 1.0:
            raise RefusedError("too long")
        return Accepted()

    server, asker, heard = bus.node("server"), bus.node("asker"), Inbox()
    asker.subscribe(DIAGNOSTICS, heard.put)
    server.serve("fault", FaultRequest, inject)
    asker.ask("server", "fault", Accepted, FaultRequest(fault="blackout", duration_s=0.5))
    with pytest.raises(QueryFailedError, match="too long"):
        asker.ask("server", "fault", Accepted, FaultRequest(fault="blackout", duration_s=5.0))
    said = first(heard, lambda received: commands(received.decode()))
    asked = FaultRequest(fault="blackout", duration_s=0.5).model_dump(mode="json")
    assert json.loads(said["command/fault"]) == asked
    assert said["commands/fault"] == "1"


def commands(message: object) -> dict[str, str]:
    (diagnostic,) = read_diagnostics(message)
    return {name: value for name, value in diagnostic.values.items() if name.startswith("command")}


def test_every_service_can_be_asked_at_once(bus):
    for instance in ("one", "two", "three"):
        bus.node(instance)
    asker = bus.node("asker")
    everyone = {"one", "two", "three", "asker"}
    until(lambda: everyone == {status.name for status in asker.ask_all()})


def test_who_answers_all_answers_on_its_own_key(bus):
    bus.node("one")
    with open_client(bus.config) as session:
        replies = answers(session, KEYS.control("*", "status"))
        assert [str(reply.ok.key_expr) for reply in replies if reply.ok] == [KEYS.control("one", "status")]


def test_an_answer_that_names_another_service_does_not_count(bus):
    """On a secure bus a member may answer on its own key alone, but write there what it likes."""
    bus.node("one")
    forged = StatusReply(
        name="one", version="forged", state="ready", uptime_s=1.0, counters={}, configuration={}
    )
    asked = Event()

    def lie(query: zenoh.Query) -> None:
        with query:
            query.reply(KEYS.control("liar", "status"), forged.model_dump_json())
            asked.set()

    with open_client(bus.config) as session:
        served = session.declare_queryable(KEYS.control("liar", "status"), lie)
        asker = bus.node("asker")
        until(lambda: asker.ask_all() and asked.is_set())
        statuses = until(lambda: {each.name: each.version for each in asker.ask_all() if each.name == "one"})
        served.undeclare()
    assert statuses == {"one": "test"}


def test_a_request_that_is_too_long_is_refused_before_it_is_read(bus):
    server = bus.node("server")
    server.serve("reset", ResetRequest, lambda _: Accepted())
    payload = json.dumps({"frame_id": "x" * 70_000}).encode()
    with open_client(bus.config) as session:
        (reply,) = answers(session, KEYS.control("server", "reset"), payload)
    assert reply.err
    assert "at most 65536 are read" in reply.err.payload.to_string()
    assert "command/reset" not in server.health.diagnostic(1).values


def test_a_service_ends_when_it_is_told_to(bus):
    server = bus.node("server")
    assert bus.node("asker").ask("server", "shutdown", Accepted).accepted
    assert server.stop.wait(TIMEOUT_S)


@pytest.mark.parametrize(("instance", "verb"), [("server", "dance"), ("nobody", "status")])
def test_a_verb_that_nobody_answers_fails_and_names_the_key(bus, instance, verb):
    bus.node("server")
    with pytest.raises(QueryFailedError, match=f"^0/rpod/{instance}/{verb}: no answer"):
        bus.node("asker").ask(instance, verb, Accepted, timeout_s=0.2)


def test_a_handler_that_takes_too_long_is_no_answer(bus):
    release = Event()

    def wait(_: Empty) -> Accepted:
        release.wait(TIMEOUT_S)
        return Accepted()

    bus.node("server").serve("wait", Empty, wait)
    try:
        with pytest.raises(QueryFailedError, match=r"^0/rpod/server/wait: "):
            bus.node("asker").ask("server", "wait", Accepted, timeout_s=0.2)
    finally:
        release.set()


@pytest.mark.parametrize(
    ("payload", "field"),
    [
        (b"{", "request"),
        (b"", "fault"),
        (b"[]", "request"),
        (b'{"fault": "fire", "duration_s": 1}', "fault"),
        (b'{"fault": "dropout", "duration_s": -1}', "duration_s"),
        (b'{"fault": "dropout", "duration_s": 1, "extra": 1}', "extra"),
        (b"\xff\xfe", "request"),
    ],
)
def test_a_request_that_is_none_is_refused_and_the_field_named(bus, payload, field):
    bus.node("server").serve("fault", FaultRequest, lambda _: Accepted())
    with open_client(bus.config) as session:
        replies = answers(session, KEYS.control("server", "fault"), payload)
    (reply,) = [
        ErrorReply.model_validate_json(reply.err.payload.to_bytes()) for reply in replies if reply.err
    ]
    assert reply.error == "BadRequest"
    assert reply.message.startswith(f"{field}: ")


@pytest.mark.parametrize(
    ("error", "text", "logged"),
    [
        (RefusedError("no log is open"), "RefusedError: no log is open", False),
        (ConfigurationError("reset", "frame_id", "'x'"), "ConfigurationError: reset: frame_id: 'x'", False),
        (ZeroDivisionError("by zero"), "ZeroDivisionError: by zero", True),
    ],
)
def test_what_a_handler_raises_is_the_answer_and_the_service_goes_on(bus, caplog, error, text, logged):
    def fail(_: Empty) -> Accepted:
        raise error

    bus.node("server").serve("fail", Empty, fail)
    asker = bus.node("asker")
    with caplog.at_level(logging.ERROR):
        for _ in range(2):
            with pytest.raises(QueryFailedError) as failed:
                asker.ask("server", "fail", Accepted)
            assert str(failed.value) == f"0/rpod/server/fail: {text}"
    assert bool(caplog.records) is logged


def test_an_answer_of_another_kind_is_a_failed_query(bus):
    bus.node("server")
    with pytest.raises(QueryFailedError, match="the answer is not a LogReply"):
        bus.node("asker").ask("server", "status", LogReply)


def test_requests_and_replies_are_json(bus):
    bus.node("server")
    with open_client(bus.config) as session:
        (reply,) = answers(session, KEYS.control("server", "status"))
        assert json.loads(reply.ok.payload.to_bytes())["name"] == "server"


# --- the router ---


def test_without_a_router_a_node_says_so_and_what_to_do():
    endpoint = free_endpoint()
    with pytest.raises(NoRouterError) as error:
        Node(config(endpoint, connect_timeout_s=0.1), version="test").__enter__()
    assert re.sub(r"after \d+ s", "after N s", str(error.value)) == (
        f"no router at {endpoint} after N s; start one with 'rpod router', name another with --connect, "
        "or let this service wait with --wait"
    )


def test_a_node_that_waits_finds_the_router_when_it_comes():
    endpoint, found, opened = free_endpoint(), Event(), Event()

    def body() -> None:
        with Node(config(endpoint, connect_timeout_s=0.1, wait=True), version="test"):
            found.set()
            opened.wait(TIMEOUT_S)

    thread = Thread(target=body)
    thread.start()
    try:
        assert not found.wait(0.5)
        with open_router(RouterConfig(listen=endpoint)):
            assert found.wait(TIMEOUT_S)
            opened.set()
            thread.join(TIMEOUT_S)
    finally:
        opened.set()
    assert not thread.is_alive()


def test_a_node_that_waits_can_be_stopped():
    stop, raised = Event(), []

    def body() -> None:
        try:
            Node(config(free_endpoint(), wait=True), version="test", stop=stop).__enter__()
        except NoRouterError as error:
            raised.append(error)

    thread = Thread(target=body)
    thread.start()
    stop.set()
    thread.join(TIMEOUT_S)
    assert not thread.is_alive()
    (error,) = raised
    assert "stopped after it had waited" in str(error)
    assert "--wait" not in str(error)


def test_a_client_that_starts_again_under_its_identity_is_heard_at_once(bus):
    """A killed one cannot say that it has ended, so that receivers still know its session."""
    heard = Inbox()
    bus.node("listener").subscribe(CLOCK, heard.put, recover=True)
    for published in (5, 1):
        clock = bus.node("estimator", zenoh_id="e57a7e").publisher(CLOCK)
        for number in range(1, published + 1):
            clock.publish(write_clock(number))
        assert len(collect(heard, published)) == published


def test_two_routers_cannot_listen_at_one_endpoint():
    with (
        router() as endpoint,
        pytest.raises(EndpointError, match=f"cannot listen on {endpoint}.*in use") as error,
    ):
        open_router(RouterConfig(listen=endpoint))
    assert "[" not in str(error.value), "its brackets match"


def test_a_router_without_estimators_to_guard_against_is_a_router():
    endpoint = free_endpoint()
    with open_router(RouterConfig(listen=endpoint, estimators=())), open_client(BusConfig(connect=endpoint)):
        pass


def test_nodes_find_a_router_that_was_restarted():
    """A session reconnects by itself; the node is reachable again."""
    endpoint = free_endpoint()
    with open_router(RouterConfig(listen=endpoint)):
        node = Node(config(endpoint), version="test").__enter__()
    try:
        with open_router(RouterConfig(listen=endpoint)), open_client(BusConfig(connect=endpoint)) as asker:
            deadline_s = monotonic() + TIMEOUT_S
            pause, replies = Event(), []
            while not replies and monotonic() < deadline_s:
                replies = [
                    reply for reply in asker.get(KEYS.control("late", "status"), timeout=1.0) if reply.ok
                ]
                pause.wait(0.05)
            assert replies
    finally:
        node.__exit__(None, None, None)


# --- from body to exit code ---


@pytest.fixture
def quiet(monkeypatch):
    """Keep the handlers of signals and logging as the tests need them."""
    monkeypatch.setattr("rpod_runtime.process.lifecycle._handle_signals", lambda *_: None)
    monkeypatch.setattr("rpod_runtime.process.lifecycle.configure_logging", lambda *_: None)
    monkeypatch.delenv("RPOD_SUPERVISED", raising=False)


@pytest.mark.usefixtures("quiet")
@pytest.mark.parametrize(
    ("error", "code"),
    [
        (None, EXIT_OK),
        (ConfigurationError("a.yaml", "rate_hz", "is odd"), EXIT_USAGE),
        (LockstepError("estimator", "a status", 60.0), EXIT_FAILURE),
        (ZeroDivisionError("by zero"), EXIT_FAILURE),
    ],
)
def test_the_exit_code_tells_how_a_service_ended_and_the_reason_is_logged_once(bus, caplog, error, code):
    def body(stop: Event) -> None:
        with Node(bus.node("template").config, version="test", stop=stop):
            if error:
                raise error

    with caplog.at_level(logging.ERROR):
        assert run("service", body) == code
    assert len(caplog.records) == (error is not None)
    assert str(error or "") in caplog.text


@pytest.mark.usefixtures("quiet")
def test_who_finds_no_router_fails():
    def body(_: Event) -> None:
        raise NoRouterError("tcp/x", 5.0)

    assert run("service", body) == EXIT_FAILURE


@pytest.mark.usefixtures("quiet")
def test_who_is_told_to_stop_while_it_waits_for_a_router_ends_well():
    def body(stop: Event) -> None:
        stop.set()
        raise NoRouterError("tcp/x", 1.0)

    assert run("service", body) == EXIT_OK
