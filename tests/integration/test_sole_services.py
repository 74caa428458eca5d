"""Two services of one name on one bus: the second does not start, or both say so."""

from threading import Event, Timer

import pytest
from live_bus import daemon, first
from secure_bus import secure_bus

from rpod_emulator.daemon import run as emulate
from rpod_logger.daemon import run as record
from rpod_motion.daemon import run as move
from rpod_runtime import Inbox
from rpod_runtime.errors import AlreadyRunningError
from rpod_schemas.config.emulator import EmulatorConfig, MotionServiceConfig
from rpod_schemas.config.facility.logger import LoggerConfig
from rpod_schemas.messages import read_diagnostics
from rpod_schemas.rmw.wire import token_pattern
from rpod_schemas.topics import DIAGNOSTICS, TRUTH, Namespace

MOTION = {
    "target": "mockup",
    "duration_s": 600.0,
    "motion": {"trajectory": {"kind": "approach", "start_m": [0, 0, 4.0], "end_m": [0, 0, 3.9]}},
}
EMULATOR = {"target": "mockup", "sensors": [{"kind": "pmd"}]}
TIMEOUT_S = 60.0


def told(inbox, name):
    """Return what the services of a name say of another one, by their session."""

    def found(received):
        return [
            (received.session, item.values["second_service"], item.level)
            for item in read_diagnostics(received.decode())
            if item.name == name and "second_service" in item.values
        ]

    return first(inbox, found, TIMEOUT_S)[0]


@pytest.mark.parametrize(
    ("run", "kind", "document"),
    [(move, MotionServiceConfig, MOTION), (emulate, EmulatorConfig, EMULATOR)],
    ids=["motion", "emulator"],
)
def test_a_second_motion_service_or_emulator_of_the_name_does_not_start(bus, run, kind, document):
    config = kind(bus=bus.config, **document)
    inbox = Inbox()
    bus.node("listener").subscribe(DIAGNOSTICS, inbox.put)
    with daemon(run, config):
        works = lambda one: any(item.name == config.instance for item in read_diagnostics(one.decode()))  # noqa: E731
        assert first(inbox, works, TIMEOUT_S)
        with pytest.raises(AlreadyRunningError, match=f"another '{config.instance}' is at work on this bus"):
            run(config, version="test", stop=Event())


@pytest.fixture(scope="module")
def secure(tmp_path_factory):
    with secure_bus(tmp_path_factory.mktemp("secure")) as bus:
        yield bus


@pytest.mark.parametrize(
    ("run", "kind", "document"),
    [(move, MotionServiceConfig, MOTION), (emulate, EmulatorConfig, EMULATOR)],
    ids=["motion", "emulator"],
)
def test_on_a_secure_bus_a_second_one_does_not_start_either(request, secure, run, kind, document):
    name = request.node.callspec.id
    config = kind(bus=secure.bus(name), **document)
    inbox = Inbox()
    with secure.node("logger") as listener:
        listener.subscribe(DIAGNOSTICS, inbox.put)
        with daemon(run, config):
            works = lambda one: any(item.name == name for item in read_diagnostics(one.decode()))  # noqa: E731
            assert first(inbox, works, TIMEOUT_S)
            stop = Event()
            timer = Timer(15.0, stop.set)
            timer.start()
            with pytest.raises(AlreadyRunningError, match=f"another '{name}' is at work on this bus"):
                run(config, version="test", stop=stop)
            timer.cancel()


def test_on_a_secure_bus_motion_beside_robots_and_two_loggers_say_so(secure, tmp_path):
    inbox = Inbox()
    with secure.node("view") as listener, secure.node("robots") as robots:
        listener.subscribe(DIAGNOSTICS, inbox.put)
        robots.publisher(TRUTH)
        with daemon(move, MotionServiceConfig(bus=secure.bus("motion"), **MOTION)):
            assert "another service publishes truth/odometry" in told(inbox, "motion")[1]
        with (
            daemon(record, LoggerConfig(bus=secure.bus("logger"), directory=tmp_path, name="one")),
            daemon(record, LoggerConfig(bus=secure.bus("logger"), directory=tmp_path, name="two")),
        ):
            assert "another service has the name 'logger'" in told(inbox, "logger")[1]


def test_on_a_secure_bus_a_service_sees_no_token_but_those_of_its_own_name(secure):
    with secure.node("motion"), secure.client("motion") as same, secure.client("emulator") as other:
        named = token_pattern(Namespace(), "NN", "motion")
        seen = {}
        for name, session in (("same", same), ("other", other)):
            replies = [*session.liveliness().get(named), *session.liveliness().get("@ros2_lv/**")]
            seen[name] = [str(reply.ok.key_expr) for reply in replies if reply.ok]
    assert len(seen["same"]) == 1
    assert seen["other"] == []


def test_motion_beside_robots_that_publish_the_truth_says_so(bus):
    inbox, robots = Inbox(), bus.node("robots")
    bus.node("listener").subscribe(DIAGNOSTICS, inbox.put)
    robots.publisher(TRUTH)
    with daemon(move, MotionServiceConfig(bus=bus.config, **MOTION)):
        _, text, _ = told(inbox, "motion")
    assert text.startswith(f"another service publishes truth/odometry (session {robots.session_id}, this one")


def test_two_loggers_of_one_name_both_record_and_both_say_so(bus, tmp_path):
    inbox, seen = Inbox(), {}
    bus.node("listener").subscribe(DIAGNOSTICS, inbox.put)
    with (
        daemon(record, LoggerConfig(bus=bus.config, directory=tmp_path, name="one")),
        daemon(record, LoggerConfig(bus=bus.config, directory=tmp_path, name="two")),
    ):
        while len(seen) < 2:
            session, text, _ = told(inbox, "logger")
            seen[session] = text
    for session, text in seen.items():
        (other,) = seen.keys() - {session}
        assert f"another service has the name 'logger' (session {other}, this one is {session})" in text
    assert {path.name for path in tmp_path.glob("*.mcap")} == {"one.mcap", "two.mcap"}
