"""What is recorded."""

from itertools import combinations

import pytest
import zenoh

from rpod_logger.selection import Extras, patterns
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.topics import DEPTH, ESTIMATE, ESTIMATE_FRAME, POINTS, TOPICS, Namespace

KEYS = Namespace(3, "servicer")


def test_every_topic_of_the_icd_is_recorded_for_any_sensor_and_estimator():
    for topic in TOPICS:
        concrete = topic.of("front_cam") if topic.name.startswith("<") else topic
        assert any(pattern.covers(concrete) for pattern in patterns()), topic
    for topic in (ESTIMATE.under("second"), ESTIMATE_FRAME.under("second").at("grapple")):
        assert any(pattern.covers(topic) for pattern in patterns())


def test_no_two_subscriptions_overlap():
    for one, other in combinations(patterns(), 2):
        first, second = (zenoh.KeyExpr(KEYS.selector(pattern)) for pattern in (one, other))
        assert not first.intersects(second), f"{one.name} and {other.name}"


def test_latched_topics_stay_latched_as_patterns():
    assert {topic.name for topic in patterns() if topic.latched} == {
        topic.name.replace("<camera>", "*").replace("<lidar>", "*") for topic in TOPICS if topic.latched
    }


def test_an_extra_owns_a_key_only_once_and_never_one_of_the_icd():
    extras = Extras(KEYS, ["3/servicer/**", "3/servicer/lab/*", "9/other"])
    depth = KEYS.key(DEPTH.of("pmd"))
    assert not any(extras.owns(index, depth) for index in range(3))
    assert [extras.owns(index, "3/servicer/lab/raw") for index in range(3)] == [True, False, False]
    assert extras.owns(2, "9/other")


def test_a_key_expression_that_is_none_is_a_configuration_error():
    with pytest.raises(ConfigurationError, match="record_extra"):
        Extras(KEYS, ["0//broken"])


def test_any_key_has_a_topic_and_a_type_where_it_is_known():
    assert KEYS.topic_at(KEYS.key(POINTS.of("lidar"))) == POINTS.of("lidar")
    assert KEYS.topic_at("3/servicer/lab/raw").type == ""
    unknown = KEYS.topic_at("3/servicer/x/lab_msgs::msg::dds_::Nobody_/RIHS01_00")
    assert (unknown.name, unknown.type) == ("x/lab_msgs::msg::dds_::Nobody_/RIHS01_00", "")
    assert KEYS.topic_at("alone").name == "alone"


def test_of_keys_without_end_the_last_ones_are_remembered():
    extras = Extras(KEYS, ["lab/**"])
    assert all(extras.owns(0, f"lab/{number}") for number in range(5000))
    assert extras._first.cache_info().currsize < 5000
