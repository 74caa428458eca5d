"""Which stamps can be of a log: in lockstep it holds those of two clocks."""

import struct
from dataclasses import dataclass
from types import SimpleNamespace

import pytest

from rpod_analysis.log.stamp_check import StampCheck
from rpod_schemas.errors import MessageRejectedError

SECOND_NS = 1_000_000_000
WALL_NS, SCENARIO_NS = 1_795_000_000 * SECOND_NS, 1_767_000_000 * SECOND_NS
YEAR_NS = 365 * 86_400 * SECOND_NS
DIAGNOSTICS, POINTS = "diagnostic_msgs/msg/DiagnosticArray", "sensor_msgs/msg/PointCloud2"


@dataclass
class Message:
    topic: str
    type: str
    log_ns: int
    stamp_ns: int

    @property
    def payload(self) -> bytes:
        return b"\x00\x01\x00\x00" + struct.pack("<iI", *divmod(self.stamp_ns, SECOND_NS)) + bytes(8)


class Log:
    """Diagnostics by the wall clock from the beginning on, later scans by the scenario's."""

    start_ns = WALL_NS

    def __init__(self, *others: Message) -> None:
        self._messages = [
            *(Message("diagnostics", DIAGNOSTICS, WALL_NS + n, WALL_NS + n) for n in range(200)),
            *(
                Message("lidar/points", POINTS, WALL_NS + n * SECOND_NS, SCENARIO_NS + n * SECOND_NS)
                for n in range(2, 9)
            ),
            *others,
        ]
        self.topics = {message.topic: SimpleNamespace(type=message.type) for message in self._messages}

    def messages(self, *topics: str):
        return (message for message in self._messages if message.topic in topics)


def test_stamps_of_both_clocks_are_of_the_log():
    log = Log()
    check = StampCheck(log)
    for message in log.messages("diagnostics", "lidar/points"):
        assert check.peek(message) == message.stamp_ns


@pytest.mark.parametrize(("years", "words"), [(3, "ahead of"), (-3, "behind")])
def test_a_single_stamp_of_another_year_is_refused(years, words):
    wrong = Message("lidar/points", POINTS, WALL_NS + 10 * SECOND_NS, WALL_NS + years * YEAR_NS)
    with pytest.raises(MessageRejectedError, match=words):
        StampCheck(Log(wrong)).peek(wrong)


def test_a_sensors_info_from_before_the_clock_runs_has_no_stamp():
    info = Message("lidar/info", "rpod_msgs/msg/LidarInfo", WALL_NS, 0)
    assert StampCheck(Log(info)).peek(info) is None


def test_a_validity_before_the_first_estimate_has_no_stamp():
    validity = Message("estimate/validity", "rpod_msgs/msg/EstimateValidity", WALL_NS, 0)
    assert StampCheck(Log(validity)).peek(validity) is None
