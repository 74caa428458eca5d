import re
from pathlib import Path

import pytest
import zenoh
from secure_bus import KEYS, SERVICE, members

from rpod_logger.selection import patterns
from rpod_schemas.config.base import check, load
from rpod_schemas.config.driver import DriverConfig
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.config.facility.rights import RightsConfig, SensorGrant
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.rmw.wire import publisher_tokens, token_pattern
from rpod_schemas.topics import SENT_BY, TOPICS, TRUTH_TOPICS, Namespace
from rpod_security.certificates import Identity
from rpod_security.errors import RulesError
from rpod_security.facility import member_of, named, other_host
from rpod_security.facility import rules_of as rules_of_rights
from rpod_security.roles import ROLES, Member
from rpod_security.rules import OtherHost, Rules
from rpod_view.scene import pose_topics, sensor_topics

ICD = Path(__file__).parents[3] / "schemas" / "ICD.md"
WORDS = {
    "motion": "motion",
    "robots": "the robots' driver",
    "lamp": "the lamp's driver",
    "sensor": "each sensor",
    "replay": "replay",
    "guidance": "the user's guidance",
    "chaser": "the chaser",
    "service": "every service",
}


def rules_of(*given: Member, keys: Namespace = KEYS) -> dict:
    members = given or tuple(self_made())
    return Rules(keys, members, [SERVICE]).access_control({each.name: f"{each.name}.1" for each in members})


def self_made() -> list[Member]:
    return members()


def allows(rules: dict, name: str, flow: str, message: str, key: str) -> bool:
    """Return what Zenoh decides: one rule of the subject includes the key."""
    (policy,) = [policy for policy in rules["policies"] if policy["subjects"] == [name]]
    asked = zenoh.KeyExpr(key)
    return any(
        zenoh.KeyExpr(allowed).includes(asked)
        for rule in rules["rules"]
        if rule["id"] in policy["rules"] and flow in rule["flows"] and message in rule["messages"]
        for allowed in rule["key_exprs"]
    )


def test_the_senders_are_those_of_the_icd():
    rows = re.findall(
        r"^\| `([\w/<>]+)` \| \w+/\w+[^|]* \| [^|]* \| ([^|]*) \|", ICD.read_text("utf-8"), re.M
    )
    assert [name for name, _ in rows] == list(dict.fromkeys(topic.name for topic in TOPICS))
    for name, words in rows:
        for sender in SENT_BY[name]:
            assert WORDS.get(sender, sender) in words or (name == "tf_static" and "sensor" in words)


def test_everything_is_denied_that_no_rule_allows():
    rules = rules_of()
    assert rules["enabled"] is True
    assert rules["default_permission"] == "deny"
    assert {rule["permission"] for rule in rules["rules"]} == {"allow"}


def test_no_rule_allows_a_deletion_or_the_administration_of_the_router():
    rules = rules_of()
    assert not [rule for rule in rules["rules"] if "delete" in rule["messages"]]
    assert not [key for rule in rules["rules"] for key in rule["key_exprs"] if key.startswith("@/")]


def test_no_rule_names_a_session():
    assert "zids" not in str(rules_of())
    assert all(list(subject) == ["id", "cert_common_names"] for subject in rules_of()["subjects"])


@pytest.mark.parametrize("topic", patterns(), ids=lambda topic: topic.name)
def test_the_logger_may_subscribe_as_it_does(topic):
    assert allows(rules_of(), "logger", "ingress", "declare_subscriber", KEYS.selector(topic))


@pytest.mark.parametrize("topic", [*sensor_topics(), *pose_topics("estimate")], ids=lambda topic: topic.name)
def test_the_view_may_subscribe_as_it_does(topic):
    assert allows(rules_of(), "view", "ingress", "declare_subscriber", KEYS.selector(topic))


@pytest.mark.parametrize("keys", [Namespace(3, "lab/east"), Namespace(0, "lab"), Namespace(1)])
def test_rules_hold_in_one_domain_and_namespace_alone(keys):
    rules = rules_of(keys=keys)
    for topic in TRUTH_TOPICS:
        assert allows(rules, "motion", "ingress", "put", keys.key(topic))
        assert not allows(rules, "motion", "ingress", "put", Namespace().key(topic))
        assert not allows(rules, "logger", "egress", "put", Namespace(keys.domain, "other").key(topic))


def test_an_estimator_with_another_prefix_has_the_topics_of_its_own():
    second = Member("second", "estimator", prefix="b")
    rules = rules_of(*self_made(), second)
    estimate = "0/{}/status/rpod_msgs::msg::dds_::EstimatorStatus_/x"
    for name, own, other in (("second", "b", "estimate"), ("estimator", "estimate", "b")):
        assert allows(rules, name, "ingress", "put", estimate.format(own))
        assert not allows(rules, name, "ingress", "put", estimate.format(other))
    assert allows(rules, "guidance", "ingress", "declare_subscriber", estimate.format("b"))


@pytest.mark.parametrize(
    "rival",
    [
        Member("rival", "estimator"),
        Member("rival", "driver", (SensorGrant(kind="pmd", name="pmd"),)),
        Member("rival", "estimator", prefix="truth"),
    ],
)
def test_two_members_never_publish_the_same(rival: Member):
    with pytest.raises(RulesError, match=r"would publish .* as (estimator|emulator|motion) does"):
        rules_of(*self_made(), rival)


def test_a_remapped_sensor_is_read_where_its_driver_publishes_it():
    sensor = {
        "kind": "pmd",
        "name": "pmd",
        "source": {"namespace": "cam", "topics": {"depth": "depth", "camera_info": "info"}},
    }
    config = check(EstimatorConfig, {"target": "mockup", "sensors": [sensor]}, source="test")
    rules = rules_of(member_of("estimator", "estimator", config))
    depth = "0/{}/sensor_msgs::msg::dds_::Image_/x"
    assert allows(rules, "estimator", "ingress", "declare_subscriber", depth.format("cam/depth"))
    assert not allows(
        rules, "estimator", "ingress", "declare_subscriber", depth.format("pmd/depth/image_raw")
    )


def test_a_driver_publishes_its_own_sensor():
    driver = member_of("cam", "driver", DriverConfig(instance="cam", kind="lidar", name="front"))
    assert {topic.name for topic in driver.publishes} - {"rosout", "parameter_events"} == {
        "front/points",
        "front/info",
        "tf_static",
        "diagnostics",
    }


def test_a_member_without_a_certificate_has_no_rights():
    rules = Rules(KEYS, self_made()).access_control({"motion": "motion.1"})
    assert [subject["id"] for subject in rules["subjects"]] == ["motion"]


def test_a_certificate_of_another_role_gives_none_of_the_members():
    with pytest.raises(RulesError, match="of a view, not of a motion"):
        named(Rules(KEYS, self_made()), [Identity("motion", "view")])


def test_a_file_of_members_is_read_with_the_configurations_that_it_names(tmp_path: Path):
    (tmp_path / "camera.yaml").write_text("instance: cam\nkind: pmd\nname: front\n")
    (tmp_path / "facility.yaml").write_text(
        "members:\n"
        "  cam: {role: driver, config: camera.yaml}\n"
        "  estimator: {role: estimator}\n"
        "  operator: {role: operator}\n"
        "ros_services:\n"
        "  estimator/set_parameters: {server: estimator, client: operator}\n"
    )
    rules = read_rules(tmp_path / "facility.yaml").access_control({"cam": "cam.1", "operator": "operator.4"})
    assert allows(rules, "cam", "ingress", "put", "0/front/info/rpod_msgs::msg::dds_::PmdInfo_/x")
    service = "0/estimator/set_parameters/rcl_interfaces::srv::dds_::SetParameters_/x"
    assert allows(rules, "operator", "ingress", "query", service)
    assert not allows(rules, "cam", "ingress", "query", service)
    assert rules["subjects"][-1]["cert_common_names"] == ["operator.4"]


def read_rules(file: Path) -> Rules:
    return rules_of_rights(load(RightsConfig, file), file.parent, source=str(file))


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("members: {a: {role: admin}}", "role"),
        ("members: {a: {role: driver}}", "sensors"),
        ("members: {a: {role: lamp, config: x.yaml}}", "config"),
        ("members: {a: {role: view, config: x.yaml}}", "x.yaml"),
        ("members: {}\nros_services: {s: {server: a, client: b}}", "ros_services"),
    ],
)
def test_a_wrong_file_of_members_is_refused_by_field(tmp_path: Path, text: str, field: str):
    (tmp_path / "facility.yaml").write_text(text)
    with pytest.raises(ConfigurationError, match=field):
        read_rules(tmp_path / "facility.yaml")


def test_every_role_has_a_title():
    assert all(role.title for role in ROLES.values())


def test_the_other_host_is_known_by_its_router_and_link_and_has_its_members():
    rights = RightsConfig.model_validate(
        {
            "members": {
                "logger": {"role": "logger"},
                "estimator": {"role": "estimator", "router": "control"},
            }
        }
    )
    issued = [Identity("router", "router"), Identity("control", "router", 2), Identity("join", "link")]
    here = other_host(rights, "router", issued)
    assert here == OtherHost(frozenset({"estimator"}), ("control.2", "join.1"))
    assert other_host(rights, "control", issued).members == {"logger"}
    with pytest.raises(RulesError, match="rpod pki issue link"):
        other_host(rights, "router", issued[:2])
    with pytest.raises(RulesError, match="members name control, router"):
        other_host(rights, "elsewhere", issued)
    rules = rules_of_rights(rights, Path(), source="test").access_control(
        {"logger": "logger.1", "estimator": "estimator.1"}, here
    )
    assert [each["id"] for each in rules["subjects"]] == ["logger", "link"], "who is there has no rights here"
    alone = RightsConfig.model_validate({"members": {"logger": {"role": "logger"}}})
    assert other_host(alone, "router", issued) is None


ASKS_FOR_ITS_NAME = {"motion", "emulator", "estimator", "logger"}


@pytest.mark.parametrize("name", sorted({member.name for member in members()}))
def test_who_has_to_be_alone_may_ask_for_another_of_its_own_name_and_nobody_else(name):
    rules = rules_of()
    for other in members():
        named = token_pattern(KEYS, "NN", other.name)
        for flow, message in (
            ("ingress", "liveliness_query"),
            ("ingress", "declare_liveliness_subscriber"),
            ("egress", "liveliness_token"),
        ):
            may = other.name == name and name in ASKS_FOR_ITS_NAME
            assert allows(rules, name, flow, message, named) == may
    if name in ASKS_FOR_ITS_NAME:
        status = KEYS.control(name, "status", name)
        assert allows(rules, name, "ingress", "query", status)
        assert allows(rules, name, "egress", "reply", status)
        assert not allows(rules, name, "ingress", "query", KEYS.control(name, "shutdown", name))


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_motion_watches_the_publishers_of_the_truth_alone(topic):
    (truth,) = [each for each in TOPICS if each.name == "truth/odometry"]
    tokens = publisher_tokens(KEYS, topic)
    for flow, message in (("ingress", "declare_liveliness_subscriber"), ("egress", "liveliness_token")):
        assert allows(rules_of(), "motion", flow, message, tokens) == (topic == truth)
        assert not allows(rules_of(), "emulator", flow, message, tokens)
