"""Services of ROS 2 in rmw_zenoh's form, held against what ROS 2's packages made (ros/make_oracle.py)."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import write_header
from rpod_schemas.messages.geometry import write_pose
from rpod_schemas.messages.ros import (
    ParameterValue,
    parameter_type,
    read_parameter_value,
    read_reset,
    write_log,
    write_parameter,
    write_parameter_event,
    write_parameter_value,
)
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw import qos
from rpod_schemas.rmw.cdr import decode, encode, message_class, type_hash
from rpod_schemas.rmw.qos import Qos
from rpod_schemas.rmw.wire import Attachment, GraphNode, topic_of_token, unpack_attachment
from rpod_schemas.topics import PARAMETER_EVENTS, ROSOUT, SUN, TRUTH, Namespace, Service, type_of_wire

ORACLE = json.loads((Path(__file__).parent / "ros" / "oracle.json").read_text("utf-8"))
RPOD_MSGS = Path(__file__).parents[3] / "schemas" / "rpod_msgs"
ICD = RPOD_MSGS.parent / "ICD.md"
VALUES: list[ParameterValue] = [
    None, True, -7, 0.25, "tcp/127.0.0.1:7447", b"\x01\xff", [True, False], [1, -2], [0.5, 1.5], ["a", "bcd"],
]  # fmt: skip
"""What the oracle's GetParameters_Response holds: one value of each type, in the order of the types."""
SPLIT = Service("my_logger/split", "std_srvs/srv/Trigger")
LAB = Namespace(3, "lab")


def oracle(type_name):
    return bytes.fromhex(ORACLE["cdr"][type_name])


def same_but_for_padding(ours, theirs):
    """Return whether bytes are equal, but for padding: zero in ours, anything in theirs."""
    return len(ours) <= len(theirs) and all(
        mine in (their, 0) for mine, their in zip(ours, theirs, strict=False)
    )


def read(type_name):
    """Decode the oracle's bytes, without those at the end that were reserved and not written."""
    theirs = oracle(type_name)
    for end in range(len(theirs), len(theirs) // 2, -1):
        try:
            return decode(theirs[:end], type_name)
        except MessageRejectedError:
            continue
    raise AssertionError(f"{type_name} cannot be read")


# --- hashes, keys, tokens, attachments ---


@pytest.mark.parametrize("type_name", ORACLE["hashes"])
def test_the_hash_of_a_type_is_that_of_ros(type_name):
    assert type_hash(type_name) == ORACLE["hashes"][type_name]


def test_the_key_of_a_service_is_that_of_another_client():
    assert LAB.key(SPLIT) == ORACLE["key"]
    assert LAB.selector(SPLIT) == "3/lab/my_logger/split/std_srvs::srv::dds_::Trigger_/*"
    assert type_of_wire(SPLIT.wire_type) == SPLIT.type


@pytest.mark.parametrize("kind", ["SS", "SC"])
def test_the_token_of_a_service_and_a_client_is_that_of_another_client(kind):
    assert GraphNode(LAB, "abc", "my-logger").endpoint_token(kind, 5, SPLIT) == ORACLE["tokens"][kind]


def test_an_attachment_is_that_of_another_client():
    told = ORACLE["attachment"]
    attachment = Attachment(told["sequence"], told["stamp_ns"], bytes.fromhex(told["gid"]))
    assert attachment.pack().hex() == told["bytes"]
    assert unpack_attachment(bytes.fromhex(told["bytes"])) == attachment


def test_absolute_topics_stand_outside_of_namespaces_but_in_the_domain():
    assert LAB.key(ROSOUT).startswith("3/rosout/rcl_interfaces::msg::dds_::Log_/RIHS01_")
    token = GraphNode(LAB, "abc", "logger").endpoint_token("MP", 1, PARAMETER_EVENTS)
    assert "/%lab/logger/%parameter_events/" in token
    for topic in (ROSOUT, PARAMETER_EVENTS):
        assert LAB.topic_at(LAB.key(topic)) == topic
        assert topic_of_token(GraphNode(LAB, "abc", "n").endpoint_token("MP", 1, topic), LAB) == topic
        assert (
            topic_of_token(GraphNode(LAB, "abc", "n").endpoint_token("MP", 1, topic), Namespace(3)) == topic
        )


# --- quality of service ---


@pytest.mark.parametrize(
    ("profile", "token"),
    [
        (Qos(), "::,10:,:,:,,"),
        (qos.SERVICE, "::,10:,:,:,,"),
        (qos.PARAMETERS, "::,1000:,:,:,,"),
        (qos.LATCHED, ":1:,1:,:,:,,"),
        (qos.ROSOUT, ":1:,1000:,:10,0:,,"),
        (qos.ANY_PUBLISHER, "2::,10:,:,:,,"),
        (Qos(depth=0), "::2,:,:,:,,"),
    ],
)
def test_a_quality_of_service_survives_its_token(profile, token):
    assert profile.token() == token
    assert Qos.read(token) == profile


def test_the_default_depth_of_rmw_zenoh_is_left_out_of_a_token():
    assert Qos.read("::,:,:,:,,") == Qos(depth=42)
    assert Qos.read("1:2:1,5:,:,:,,") == Qos(depth=5)


def test_a_text_that_is_no_quality_of_service_is_refused():
    with pytest.raises(ValueError, match="no quality of service"):
        Qos.read("reliable")


@pytest.mark.parametrize("offered", [Qos(), Qos(reliable=False)])
def test_our_subscribers_match_reliable_and_best_effort_publishers(offered):
    assert offered.lacks(TRUTH.asked) == []


@pytest.mark.parametrize("asked", [Qos(), Qos(reliable=False), Qos(reliable=False, depth=5)])
@pytest.mark.parametrize("topic", [TRUTH, SUN, ROSOUT], ids=lambda topic: topic.name)
def test_our_publishers_match_reliable_and_best_effort_subscribers(topic, asked):
    assert topic.offered.lacks(asked) == []


def test_what_an_offer_lacks_has_names():
    assert Qos(reliable=False).lacks(qos.LATCHED) == ["RELIABLE", "TRANSIENT_LOCAL"]


# --- bytes ---


@pytest.mark.parametrize("type_name", ORACLE["cdr"])
def test_bytes_of_ros_are_read_and_written_the_same(type_name):
    message = read(type_name)
    assert same_but_for_padding(bytes(encode(message)), oracle(type_name))


def test_parameters_of_all_types_have_the_bytes_of_ros():
    told = read("rcl_interfaces/srv/GetParameters_Response")
    assert [read_parameter_value(value) for value in told.values] == VALUES
    assert [parameter_type(value) for value in VALUES] == list(range(10))
    told.values = [write_parameter_value(value) for value in VALUES]
    assert same_but_for_padding(bytes(encode(told)), oracle("rcl_interfaces/srv/GetParameters_Response"))


def test_a_log_line_has_the_bytes_of_ros():
    line = write_log(
        12_000_000_034, level=30, name="lab.logger", text="full", file="a.py", function="f", line=7
    )
    assert same_but_for_padding(bytes(encode(line)), oracle("rcl_interfaces/msg/Log"))


def test_a_parameter_event_has_the_bytes_of_ros():
    event = write_parameter_event(
        12_000_000_034, "/lab/logger", changed=[write_parameter("log_level", "debug")]
    )
    assert same_but_for_padding(bytes(encode(event)), oracle("rcl_interfaces/msg/ParameterEvent"))


def test_an_unknown_type_of_a_parameter_is_rejected():
    message = write_parameter_value(1)
    message.type = 10
    with pytest.raises(MessageRejectedError, match="type 10 of a parameter"):
        read_parameter_value(message)


# --- reset ---


def reset_call(**changes):
    """Return a request with a pose, as bytes and back, so that it is what a service gets."""
    pose = make_pose(translation_m=np.array(changes.pop("at", [0.0, 0.0, 12.0])))
    covariance = np.asarray(changes.pop("covariance", np.zeros(36)), np.float64)
    with_covariance = message_class("geometry_msgs/msg/PoseWithCovariance")(write_pose(pose), covariance)
    header = write_header(changes.pop("stamp_ns", 0), changes.pop("frame_id", ""))
    stamped = message_class("geometry_msgs/msg/PoseWithCovarianceStamped")(header, with_covariance)
    fields = {"with_pose": True, "pose": stamped, "keep_gid": ""} | changes
    type_name = "rpod_msgs/srv/ResetEstimator_Request"
    return decode(bytes(encode(message_class(type_name)(**fields))), type_name)


def test_a_reset_with_a_pose_alone_leaves_the_rest_open():
    request = read_reset(reset_call())
    assert request.pose is not None
    assert request.pose.translation.tolist() == [0.0, 0.0, 12.0]
    assert (request.frame_id, request.stamp_ns, request.covariance, request.keep_gid) == (
        "chaser",
        None,
        None,
        None,
    )


def test_a_reset_keeps_frame_stamp_covariance_and_gid():
    covariance = np.diag([0.01] * 6).ravel()
    request = read_reset(
        reset_call(frame_id="pmd_optical", stamp_ns=5, covariance=covariance, keep_gid="ab" * 16)
    )
    assert (request.frame_id, request.stamp_ns, request.keep_gid) == ("pmd_optical", 5, "ab" * 16)
    assert request.covariance is not None
    assert request.covariance.tolist() == np.diag([0.01] * 6).tolist()


def test_a_reset_without_a_pose_is_one():
    assert read_reset(reset_call(with_pose=False, at=[0.0, 0.0, 0.0])).pose is None


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"with_pose": False}, "with_pose is false, but a pose is given"),
        ({"at": [0.0, 0.0, np.nan]}, "position"),
        ({"covariance": -np.eye(6).ravel()}, "covariance"),
        ({"keep_gid": "short"}, "keep_gid"),
    ],
)
def test_a_reset_that_is_not_valid_is_refused_with_the_field(changes, text):
    with pytest.raises(MessageRejectedError, match=text):
        read_reset(reset_call(**changes))


# --- rpod_msgs, as colcon builds it ---


def test_the_build_of_rpod_msgs_names_each_of_its_files():
    listed = re.findall(
        r'^  "((?:msg|srv)/\w+\.(?:msg|srv))"$', (RPOD_MSGS / "CMakeLists.txt").read_text("utf-8"), re.M
    )
    files = [*RPOD_MSGS.glob("msg/*.msg"), *RPOD_MSGS.glob("srv/*.srv")]
    assert sorted(listed) == sorted(file.relative_to(RPOD_MSGS).as_posix() for file in files)


def test_rpod_msgs_depends_on_each_package_that_its_files_name():
    texts = [file.read_text("utf-8") for kind in ("msg", "srv") for file in (RPOD_MSGS / kind).iterdir()]
    named = set(re.findall(r"^(\w+)/\w+", "\n".join(texts), re.M))
    package = ElementTree.parse(RPOD_MSGS / "package.xml").getroot()  # noqa: S314 - our own file
    cmake = (RPOD_MSGS / "CMakeLists.txt").read_text("utf-8")
    assert {each.text for each in package.findall("depend")} == named
    assert set(re.findall(r"DEPENDENCIES (.*)", cmake)[0].split()) == named
    assert all(f"find_package({each} REQUIRED)" in cmake for each in named)


def test_each_file_of_rpod_msgs_was_read_by_the_parser_of_ros():
    files = [
        f"rpod_msgs/{kind}/{file.stem}" for kind in ("msg", "srv") for file in (RPOD_MSGS / kind).iterdir()
    ]
    assert set(files) <= set(ORACLE["hashes"])


def test_the_service_file_equals_the_icd():
    block = re.search(r"```\n# ResetEstimator\.srv\n(.*?)```", ICD.read_text("utf-8"), re.S)
    assert block is not None
    assert (RPOD_MSGS / "srv" / "ResetEstimator.srv").read_text("utf-8") == block[1]
