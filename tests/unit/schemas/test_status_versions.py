"""A status of version 1 of the ICD is read by today's code: its message is shorter."""

from importlib import resources

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import read_status, write_status
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw.cdr import decode, encode
from rpod_schemas.types import BeliefLevel, EstimatorStatus, Hypothesis, Mode, Source

TYPE = "rpod_msgs/msg/EstimatorStatus"
STATUS = EstimatorStatus(
    stamp_ns=12,
    frame_id="chaser",
    mode=Mode.TRACKING,
    source=Source.PMD_JOINT,
    sensor="pmd",
    accepted=True,
    hypotheses=(
        Hypothesis(pose=make_pose(), weight=0.75, log_likelihood=0.0),
        Hypothesis(pose=make_pose(), weight=0.25, name="turned by 90 deg", log_likelihood=-1.1),
    ),
    belief=BeliefLevel.DOUBTFUL,
    evidence={"edges_in_place_share": 0.52, "range_bias_m": 0.01},
)


def test_belief_evidence_and_names_survive_the_wire() -> None:
    read = read_status(decode(bytes(encode(write_status(STATUS))), TYPE))
    assert (read.belief, read.evidence) == (STATUS.belief, STATUS.evidence)
    assert [(h.name, h.log_likelihood) for h in read.hypotheses] == [("", 0.0), ("turned by 90 deg", -1.1)]


def test_a_status_of_version_1_is_read_without_them() -> None:
    text = resources.files("rpod_msgs").joinpath("older", "EstimatorStatus_1.msg").read_text("utf-8")
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(text, TYPE))
    today = write_status(STATUS)
    kept = {name: getattr(today, name) for name, _ in store.fielddefs[TYPE][1]}
    payload = bytes(store.serialize_cdr(store.types[TYPE](**kept), TYPE))
    read = read_status(decode(payload, TYPE))
    assert (read.mode, read.sensor, read.belief, read.evidence) == (
        Mode.TRACKING, "pmd", BeliefLevel.ACCEPTED, {},
    )  # fmt: skip
    assert [h.weight for h in read.hypotheses] == [0.75, 0.25]
    assert np.isnan(read.hypotheses[1].log_likelihood)


def test_bytes_of_no_version_are_refused() -> None:
    with pytest.raises(MessageRejectedError, match="malformed"):
        decode(bytes(encode(write_status(STATUS)))[:40], TYPE)
