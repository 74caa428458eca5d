"""Services, parameters and log lines of the facility, as another program of ROS 2 finds them on the bus."""

import json
import logging
import struct
from collections.abc import Iterator
from contextlib import ExitStack
from threading import Event

import numpy as np
import pytest
import zenoh
from facility_process import until
from live_bus import Bus, daemon, first, router
from ros_client import HASHES, NoReplyError, RosClient, assignment, message, parameters

from rpod_logger.daemon import run as run_logger
from rpod_runtime import Inbox, Node
from rpod_runtime.errors import RefusedError
from rpod_runtime.ros import RESET_SERVICE, trigger
from rpod_runtime.ros.offers import offer_watch
from rpod_runtime.ros.rosout import RosoutHandler
from rpod_schemas.config.facility.logger import LoggerConfig
from rpod_schemas.config.service import BusConfig, ServiceConfig
from rpod_schemas.control import Accepted, Empty, LogReply, LogRequest, ResetRequest, StatusReply
from rpod_schemas.topics import COMMAND, DIAGNOSTICS, PARAMETER_EVENTS, ROSOUT, SUN
from rpod_schemas.types import Health

TRIGGER, RESET = "std_srvs/srv/Trigger", "rpod_msgs/srv/ResetEstimator"
SIX = (
    "get_parameters", "get_parameter_types", "list_parameters", "describe_parameters",
    "set_parameters", "set_parameters_atomically",
)  # fmt: skip


@pytest.fixture
def client(endpoint) -> Iterator[RosClient]:
    with RosClient(endpoint) as client:
        yield client


@pytest.fixture(autouse=True)
def _level() -> Iterator[None]:
    """Give the process back its level of log lines, which a parameter changes."""
    before = logging.getLogger().level
    yield
    logging.getLogger().setLevel(before)


# --- services ---


def test_shutdown_is_a_trigger_service(bus, client):
    node = bus.node("my-camera")
    response = client.call("/my_camera/shutdown", TRIGGER)
    assert response.success
    assert json.loads(response.message) == {"accepted": True}
    assert node.stop.is_set()


def test_a_reply_repeats_the_sequence_number_and_the_gid_of_the_call(bus, client):
    node = bus.node("server")
    node.serve("split", LogRequest, lambda _: Accepted(), ros=trigger(LogRequest))
    for _ in range(2):
        client.call("/server/split", TRIGGER)
        assert client.replied == (client.sequence, client.gid)


def test_a_failure_is_a_normal_reply_that_says_why(bus, client):
    def refuse(_: LogRequest) -> LogReply:
        raise RefusedError("the disk is full; free some space")

    node = bus.node("server")
    node.serve("split", LogRequest, refuse, ros=trigger(LogRequest))
    response = client.call("/server/split", TRIGGER)
    assert not response.success
    assert response.message == "RefusedError: the disk is full; free some space"
    assert "commands/split" not in node.health.counters()


def test_a_call_that_was_accepted_is_in_the_diagnostics_like_a_query(bus, client):
    node, heard = bus.node("server"), Inbox()
    bus.node("listener").subscribe(DIAGNOSTICS, heard.put)
    node.serve("split", LogRequest, lambda _: Accepted(), ros=trigger(LogRequest))
    client.call("/server/split", TRIGGER)
    assert node.health.counters()["commands/split"] == 1
    assert first(heard, lambda received: "command/split" in str(received.decode()))


def test_a_damaged_request_is_refused_with_a_normal_reply(bus, client):
    bus.node("server").serve("reset", ResetRequest, lambda _: Accepted(), ros=RESET_SERVICE)
    client.await_service("/server/reset")
    key = client.key("/server/reset", RESET)
    response = client.send(key, b"\x00\x01\x00\x00\x01", "rpod_msgs/msg/ResetEstimator_Response")
    assert not response.success
    assert "malformed" in response.message


@pytest.mark.parametrize("attachment", [b"", struct.pack("<qqB16s", 1, 1, 15, bytes(16))])
def test_a_call_without_a_usable_attachment_gets_an_error_reply(bus, client, attachment):
    bus.node("server")
    client.await_service("/server/shutdown")
    key = client.key("/server/shutdown", TRIGGER)
    with pytest.raises(NoReplyError, match="attachment"):
        client.send(key, bytes.fromhex("0001000000"), "std_srvs/msg/Trigger_Response", attachment)


@pytest.mark.parametrize("type_hash", ["TypeHashNotSupported", "*"])
def test_a_client_without_the_hash_is_answered_too(bus, client, type_hash):
    bus.node("server")
    assert client.call("/server/shutdown", TRIGGER, type_hash=type_hash).success


def test_a_reset_takes_a_pose(bus, client):
    asked: list[ResetRequest] = []

    def reset(request: ResetRequest) -> Accepted:
        asked.append(request)
        return Accepted()

    bus.node("estimator").serve("reset", ResetRequest, reset, ros=RESET_SERVICE)
    pose = pose_at(0.5, -0.2, 9.0)
    response = client.call("/estimator/reset", RESET, with_pose=True, pose=pose, keep_gid="")
    assert response.success
    assert asked[0].pose is not None
    assert asked[0].pose.translation.tolist() == [0.5, -0.2, 9.0]
    assert asked[0].frame_id == "chaser"


def pose_at(x, y, z):
    point = message("geometry_msgs/msg/Point", x=x, y=y, z=z)
    level = message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    pose = message("geometry_msgs/msg/Pose", position=point, orientation=level)
    whole = message("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36))
    now = message("builtin_interfaces/msg/Time", sec=0, nanosec=0)
    header = message("std_msgs/msg/Header", stamp=now, frame_id="")
    return message("geometry_msgs/msg/PoseWithCovarianceStamped", header=header, pose=whole)


def test_the_loggers_start_stop_and_split_are_trigger_services(bus, client, tmp_path):
    config = LoggerConfig(bus=bus.config, directory=tmp_path, name="first")
    with daemon(run_logger, config):
        split = client.call("/logger/split", TRIGGER)
        stop = client.call("/logger/stop", TRIGGER)
        again = client.call("/logger/stop", TRIGGER)
        start = client.call("/logger/start", TRIGGER)
    assert [each.success for each in (split, stop, again, start)] == [True, True, False, True]
    assert json.loads(split.message)["path"].endswith("first_0002.mcap")
    assert again.message == "NotRecordingError: not recording; use start to open a log"


# --- the graph ---


def test_each_service_has_a_token_with_the_hash_of_its_type(bus, client):
    node = bus.node("server")
    node.serve("reset", ResetRequest, lambda _: Accepted(), ros=RESET_SERVICE)
    tokens = {token.split("/", 5)[5] for token in client.tokens("SS", least=8)}
    head, quality = "SS/%/%/server/%server%", "::,10:,:,:,,"
    assert f"{head}shutdown/std_srvs::srv::dds_::Trigger_/{HASHES[TRIGGER]}/{quality}" in tokens
    assert f"{head}reset/rpod_msgs::srv::dds_::ResetEstimator_/{HASHES[RESET]}/{quality}" in tokens
    for name in SIX:
        camel = "".join(part.capitalize() for part in name.split("_"))
        wire = f"rcl_interfaces::srv::dds_::{camel}_/{HASHES[f'rcl_interfaces/srv/{camel}']}"
        assert f"{head}{name}/{wire}/::,1000:,:,:,," in tokens


def test_services_are_found_in_another_domain_and_namespace_and_nowhere_else(endpoint):
    far = BusConfig(connect=endpoint, domain=42, namespace="lab/east")
    with ExitStack() as stack:
        node = stack.enter_context(
            Node(ServiceConfig(instance="my-node", bus=far), version="test", stop=Event())
        )
        client, here = stack.enter_context(RosClient(endpoint, 42)), stack.enter_context(RosClient(endpoint))
        got = parameters(client, "lab/east/my_node", "get_parameters", names=["bus.domain"])
        assert [value.integer_value for value in got.values] == [42]
        (token,) = client.tokens("NN")
        assert token.endswith("/NN/%/%lab%east/my_node")
        assert not [token for token in here.tokens("SS", least=0) if "my_node" in token]
        assert client.call("/lab/east/my_node/shutdown", TRIGGER).success
        assert node.stop.is_set()


def test_services_are_left_out_where_the_configuration_says_so(bus, client):
    quiet = bus.config.model_copy(update={"ros_services": False})
    asker = bus.node("asker")
    with Node(ServiceConfig(instance="quiet", bus=quiet), version="test", stop=Event()) as node:
        node.serve("split", LogRequest, lambda _: Accepted(), ros=trigger(LogRequest))
        client.await_service("/asker/shutdown")
        assert not [token for token in client.tokens("SS") if "quiet" in token]
        assert asker.ask("quiet", "status", StatusReply).name == "quiet"
        assert asker.ask("quiet", "split", Accepted, Empty()).accepted
        key = client.key("/quiet/shutdown", TRIGGER)
        with pytest.raises(NoReplyError):
            client.send(key, bytes.fromhex("0001000000"), "std_srvs/msg/Trigger_Response")


@pytest.mark.parametrize("reliability", [zenoh.Reliability.RELIABLE, zenoh.Reliability.BEST_EFFORT])
def test_our_subscribers_take_reliable_and_best_effort_publishers(bus, client, reliability):
    heard = Inbox()
    bus.node("receiver").subscribe(COMMAND, heard.put, recover=True)
    (token,) = [token for token in client.tokens("MS") if "guidance%command" in token]
    assert token.endswith("/2::,10:,:,:,,")
    publisher = client.session.declare_publisher(token_to_key(token), reliability=reliability)
    for number in range(1, 200):  # until the router knows the subscriber
        publisher.put(b"", attachment=struct.pack("<qqB16s", number, 1, 16, bytes(16)))
        if first(heard, lambda received: received.attachment.gid == bytes(16), timeout_s=0.1):
            return
    pytest.fail("nothing was received")


def test_a_publisher_whose_latched_topic_is_not_latched_is_told(bus, client):
    node = bus.node("receiver")
    node.subscribe(SUN, Inbox().put)
    (token,) = [token for token in client.tokens("MS") if "environment%sun" in token]
    theirs = token.replace("/MS/", "/MP/").replace("/receiver/", "/lamp/").rpartition("/")[0]
    with client.session.liveliness().declare_token(f"{theirs}/::,10:,:,:,,"):
        until(lambda: "qos/environment/sun" in node.health.diagnostic(0).values)
    told = node.health.diagnostic(0)
    assert "node lamp does not publish it as TRANSIENT_LOCAL" in told.values["qos/environment/sun"]
    assert told.level == Health.WARN


@pytest.mark.parametrize(
    ("quality", "lacks"),
    [
        (":1:,1:,:,:,,", []),
        (":1:,1000:,:10,0:,,", []),
        ("a later form", []),
        ("::,10:,:,:,,", ["TRANSIENT_LOCAL"]),
        ("2::,5:,:,:,,", ["RELIABLE", "TRANSIENT_LOCAL"]),
    ],
)
def test_what_a_publisher_of_a_latched_topic_lacks(quality, lacks):
    told = []
    offer_watch(SUN, lambda _, text: told.append(text))(f"@ros2_lv/0/a/0/1/MP/%/%/lamp/%sun/T/H/{quality}")
    assert len(told) == bool(lacks)
    assert all(name in told[0].partition(", so")[0] for name in lacks)


def test_a_line_that_is_logged_while_a_line_is_published_holds_nobody_up():
    lines = []

    def publish(line):
        lines.append(line.msg)
        logging.getLogger("rpod_test").error("again")

    handler = RosoutHandler("node", publish)
    logging.getLogger("rpod_test").error("once")
    handler.close()
    assert lines == ["once"]


def token_to_key(token):
    domain, name, wire, type_hash = (token.split("/")[place] for place in (1, 9, 10, 11))
    return f"{domain}/{name.strip('%').replace('%', '/')}/{wire}/{type_hash}"


# --- parameters ---


def test_the_configuration_is_read_as_parameters(bus, client):
    bus.node("server")
    names = parameters(client, "server", "list_parameters", prefixes=[], depth=0).result.names
    assert {"bus.connect", "bus.domain", "bus.wait", "instance", "log_level", "use_sim_time"} <= set(names)
    asked = ["bus.connect", "bus.domain", "bus.wait", "bus.connect_timeout_s", "no_such"]
    values = parameters(client, "server", "get_parameters", names=asked).values
    assert [value.type for value in values] == [4, 2, 1, 3, 0]
    assert values[0].string_value == bus.endpoint
    assert values[3].double_value == 5.0
    types = parameters(client, "server", "get_parameter_types", names=asked).types
    assert types.tolist() == [4, 2, 1, 3, 0]


def test_parameters_are_listed_by_prefix_and_depth(bus, client):
    bus.node("server")
    result = parameters(client, "server", "list_parameters", prefixes=["bus"], depth=1).result
    assert result.names
    assert all(name.startswith("bus.") for name in result.names)
    assert result.prefixes == ["bus"]
    shallow = parameters(client, "server", "list_parameters", prefixes=[], depth=1).result
    assert "instance" in shallow.names
    assert "bus.domain" not in shallow.names


def test_parameters_say_whether_they_can_be_set(bus, client):
    bus.node("server")
    told = parameters(client, "server", "describe_parameters", names=["bus.domain", "log_level"]).descriptors
    assert [(each.name, each.type, each.read_only) for each in told] == [
        ("bus.domain", 2, True),
        ("log_level", 4, False),
    ]
    assert told[1].additional_constraints == "one of debug, info, warning, error"


def test_what_cannot_change_while_running_is_refused_with_the_reason_and_the_rest_is_set(bus, client):
    node = bus.node("server")
    rate = []
    node.parameters.offer("driver.rate_hz", 5.0, rate.append, description="frames a second")
    wrong = [
        assignment("bus.domain", type=2, integer_value=1),
        assignment("no_such", type=2, integer_value=1),
        assignment("driver.rate_hz", type=2, integer_value=7),
        assignment("log_level", type=4, string_value="loud"),
        assignment("driver.rate_hz", type=3, double_value=7.5),
    ]
    results = parameters(client, "server", "set_parameters", parameters=wrong).results
    assert [result.successful for result in results] == [False, False, False, False, True]
    reasons = ("cannot change while the service runs", "no such parameter", "of type double", "is one of", "")
    assert all(reason in result.reason for result, reason in zip(results, reasons, strict=True))
    assert rate == [7.5]
    got = parameters(client, "server", "get_parameters", names=["driver.rate_hz"]).values
    assert got[0].double_value == 7.5
    assert node.health.counters()["commands/set_parameters"] == 1
    assert json.loads(node.health.diagnostic(0).values["command/set_parameters"]) == {"driver.rate_hz": 7.5}


def test_parameters_are_set_together_or_not_at_all(bus, client):
    node, rates = bus.node("server"), [5.0]
    node.parameters.offer("rate_hz", 5.0, rates.append)

    def set_both(level: str) -> bool:
        both = [
            assignment("rate_hz", type=3, double_value=9.0),
            assignment("log_level", type=4, string_value=level),
        ]
        return parameters(client, "server", "set_parameters_atomically", parameters=both).result.successful

    assert not set_both("loud")
    assert rates[-1] == 5.0
    assert node.parameters.value("rate_hz") == 5.0
    assert set_both("error")
    assert rates[-1] == 9.0
    assert logging.getLogger().level == logging.ERROR


def test_parameter_events_tell_of_the_start_and_of_each_change(bus, client):
    listener, heard = bus.node("listener"), Inbox()
    listener.subscribe(PARAMETER_EVENTS, heard.put, recover=True, history=True)
    bus.node("late")

    def names(received, part):
        event = received.decode()
        return event.node == "/late" and [each.name for each in getattr(event, part)]

    assert "bus.domain" in first(heard, lambda received: names(received, "new_parameters"))
    change = [assignment("log_level", type=4, string_value="error")]
    parameters(client, "late", "set_parameters", parameters=change)
    assert first(heard, lambda received: names(received, "changed_parameters")) == ["log_level"]


# --- log lines ---


def test_log_lines_are_on_rosout_in_every_namespace(bus):
    listener, heard = bus.node("listener"), Inbox()
    listener.subscribe(ROSOUT, heard.put, recover=True)
    bus.node("speaker", namespace="lab")
    logging.getLogger("rpod_test").warning("the lamp is %s", "off")

    def fits(received):
        line = received.decode()
        return line if line.name == "lab.speaker" else None

    line = first(heard, fits)
    assert (line.level, line.msg) == (30, "the lamp is off")
    assert line.function == "test_log_lines_are_on_rosout_in_every_namespace"
    assert line.file == __file__


def test_a_late_listener_gets_earlier_log_lines(bus):
    bus.node("speaker")
    logging.getLogger("rpod_test").error("it failed")
    heard = Inbox()
    bus.node("late").subscribe(ROSOUT, heard.put, recover=True, history=True)
    assert first(heard, lambda received: received.decode().msg == "it failed")


def test_a_node_that_has_ended_publishes_no_lines():
    before = list(logging.getLogger().handlers)
    with ExitStack() as stack:
        Bus(stack.enter_context(router()), stack).node("short")
        assert len(logging.getLogger().handlers) == len(before) + 1
    assert logging.getLogger().handlers == before
