import pytest
from hypothesis import given
from hypothesis import strategies as st

from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.rmw.wire import Attachment, GraphNode, unpack_attachment
from rpod_schemas.topics import SUN, TRUTH, Namespace

INT64 = st.integers(1, 2**63 - 1)


@given(INT64, INT64, st.binary(min_size=16, max_size=16))
def test_an_attachment_survives_its_33_bytes(sequence, stamp_ns, gid):
    attachment = Attachment(sequence, stamp_ns, gid)
    assert len(attachment.pack()) == 33
    assert unpack_attachment(attachment.pack()) == attachment


def test_a_missing_attachment_is_malformed():
    with pytest.raises(MessageRejectedError, match="no attachment") as rejected:
        unpack_attachment(None)
    assert rejected.value.reason is Reason.MALFORMED


def test_the_older_labelled_form_is_refused_by_name():
    with pytest.raises(MessageRejectedError, match="labelled attachment") as rejected:
        unpack_attachment(b"\x0fsequence_number" + bytes(60))
    assert rejected.value.reason is Reason.OLD_ATTACHMENT


@pytest.mark.parametrize("damage", [b"", bytes(32), bytes(34), bytes(33)])
def test_a_damaged_attachment_is_malformed(damage):
    with pytest.raises(MessageRejectedError) as rejected:
        unpack_attachment(damage)
    assert rejected.value.reason is Reason.MALFORMED


def test_tokens_show_node_and_endpoints_in_the_ros_graph():
    node = GraphNode(Namespace(0, "lab"), "abc", "emulator")
    assert node.node_token() == "@ros2_lv/0/abc/0/0/NN/%/%lab/emulator"
    token = node.endpoint_token("MP", 7, TRUTH)
    assert token.startswith(
        "@ros2_lv/0/abc/0/7/MP/%/%lab/emulator/%lab%truth%odometry/nav_msgs::msg::dds_::Odometry_/RIHS01_"
    )
    assert token.endswith("/::,10:,:,:,,")
    assert node.endpoint_token("MS", 8, SUN).endswith("/:1:,1:,:,:,,")


def test_tokens_without_a_namespace_carry_the_root():
    assert GraphNode(Namespace(), "abc", "logger").node_token() == "@ros2_lv/0/abc/0/0/NN/%/%/logger"
