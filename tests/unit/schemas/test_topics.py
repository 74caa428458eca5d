import re
from pathlib import Path

import pytest

from rpod_schemas.rmw.cdr import message_class, type_hash
from rpod_schemas.topics import (
    DEPTH,
    ESTIMATE_FRAME,
    ESTIMATE_POSE,
    PMD_INFO,
    POINTS,
    ROSOUT,
    STATUS,
    TF_STATIC,
    TOPICS,
    TRUTH,
    Namespace,
    type_of_wire,
)

ICD = Path(__file__).parents[3] / "schemas" / "ICD.md"


def icd_rows():
    section = ICD.read_text("utf-8").partition("\n## 2.")[2].partition("\n## 3.")[0]
    rows = re.findall(r"^\| `([\w/<>]+)` \| (\w+)/(\w+)[^|]* \| ([^|]*) \|", section, re.M)
    return [(name, f"{package}/msg/{kind}", "latched" in rate) for name, package, kind, rate in rows]


def test_the_registry_equals_the_table_of_the_icd():
    assert icd_rows() == [(topic.name, topic.type, topic.latched) for topic in TOPICS]


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_every_topic_has_a_type_that_the_codec_knows(topic):
    assert message_class(topic.type)
    assert re.fullmatch(r"RIHS01_[0-9a-f]{64}", type_hash(topic.type))
    assert type_of_wire(topic.wire_type) == topic.type


@pytest.mark.parametrize(
    ("topic", "kept"),
    [(DEPTH, 90), (POINTS, 90), (TRUTH, 500), (STATUS, 500), (TF_STATIC, 1), (PMD_INFO, 1), (ROSOUT, 1000)],
)
def test_a_publisher_keeps_what_the_icd_says(topic, kept):
    assert topic.kept == kept


def test_a_key_is_that_of_rmw_zenoh():
    key = Namespace(3, "lab/east").key(TRUTH)
    assert key.startswith("3/lab/east/truth/odometry/nav_msgs::msg::dds_::Odometry_/RIHS01_")
    assert Namespace(3, "lab/east").topic_of(key) == "truth/odometry"


def test_a_subscription_takes_any_type_hash():
    assert Namespace().selector(TRUTH) == "0/truth/odometry/nav_msgs::msg::dds_::Odometry_/*"


def test_a_sensor_topic_carries_the_sensors_name():
    assert DEPTH.of("pmd").name == "pmd/depth/image_raw"


def test_a_topic_of_no_sensor_refuses_a_sensors_name():
    with pytest.raises(ValueError, match="belongs to no sensor"):
        TRUTH.of("pmd")


def test_an_estimates_topic_moves_under_a_prefix():
    assert ESTIMATE_POSE.under("second").name == "second/pose"
    assert ESTIMATE_FRAME.under("second").at("grapple").name == "second/frames/grapple"


@pytest.mark.parametrize("name", ["EstimatorStatus", "LidarInfo", "PmdInfo"])
def test_the_message_files_equal_the_icd(name):
    block = re.search(rf"```\n# {name}\.msg\n(.*?)```", ICD.read_text("utf-8"), re.S)
    file = ICD.parent / "rpod_msgs" / "msg" / f"{name}.msg"
    assert block is not None
    assert file.read_text("utf-8") == block[1]


def test_the_icd_tells_its_history_in_the_table_of_versions_alone():
    title, *rules, versions = re.split(r"^#+ ", ICD.read_text("utf-8").strip(), flags=re.M)[1:]
    assert not re.findall(r"(?:new in|before|since) version \d+\.\d+", "".join(rules), re.I)
    rows = re.findall(r"^\| (\d+\.\d+) \|", versions, re.M)
    assert rows == sorted(rows, key=lambda row: [int(part) for part in row.split(".")])
    assert title.startswith(f"Interface control document, version {rows[-1]}\n")
