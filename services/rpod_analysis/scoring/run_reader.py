"""One pass over a log that sorts its messages by purpose and stores them as plain numbers.

The domain types are not used, because they take ten times as long as the decoding.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from rpod_analysis.log import Log, Logged
from rpod_analysis.log.accounting import Account
from rpod_analysis.log.message_checks import check_message, pose_numbers
from rpod_analysis.log.sensors import Sensor
from rpod_analysis.log.stamp_check import StampCheck
from rpod_analysis.scoring.mounts import mount_differences
from rpod_analysis.scoring.row_store import RowStore
from rpod_schemas.faults.injected import InjectedFault, read_faults
from rpod_schemas.messages import read_diagnostics, read_integrity, read_odometry, read_stamp, read_status
from rpod_schemas.rmw.cdr import peek_stamp
from rpod_schemas.summary import MountDifference
from rpod_schemas.texts import shown
from rpod_schemas.topics import CLOCK, DIAGNOSTICS, ESTIMATE, FAULTS, INTEGRITY, STATUS, TRUTH
from rpod_schemas.types import LOST_AFTER_S

_LATEST_NS = 2**63 - 1
"""Latest time that a table holds, ns; a log may say later ones."""
_MOST_FAULTS = 500
"""Largest number of faults that are kept."""
_LONGEST = 500
"""Largest number of characters of a text that is kept: in an array each text takes as much as the longest."""
_MOST_PARENTS = 8
"""Largest number of frames of reference that are kept; a run has one."""


@dataclass(eq=False)
class Found:
    """Messages of a run by purpose; each row begins with its stamp, ns."""

    sensors: dict[str, Sensor]
    status_topic: str
    truth: RowStore = field(default_factory=RowStore)
    """Rows of stamp, pose as x, y, z, qx, qy, qz, qw, and covariance as bytes, empty where it is zero."""
    estimates: RowStore = field(default_factory=RowStore)
    """Rows of stamp, pose, covariance as bytes, and time of publication."""
    statuses: RowStore = field(default_factory=RowStore)
    """Rows of stamp, place in the order of arrival, mode, source, accepted, nis, processing_s, sensor and
    reason, and whether the track was lost before."""
    integrity: RowStore = field(default_factory=RowStore)
    """Rows of stamp, state, levels of attitude and position, their alert limits, and reason."""
    frames: RowStore = field(default_factory=RowStore)
    """Rows of stamp, sensor and time of arrival."""
    parents: dict[str, str] = field(default_factory=dict)
    """Topic on which each frame of reference of truth and estimates came first, by the frame."""
    account: Account = field(default_factory=Account)
    mounts: dict[str, MountDifference] = field(default_factory=dict)
    """Newest differences between the mounts of two sensors."""
    faults: dict[tuple[str, str, int], InjectedFault] = field(default_factory=dict)
    """Faults that services injected; the first ones only."""
    clock: bool = False
    """Whether time comes from the topic ``clock``."""


class Reader:
    """Sorts the messages of a log, in the order of arrival; those that cannot be read are left out."""

    def __init__(self, log: Log, prefix: str, sensors: dict[str, Sensor]) -> None:
        self._unreadable, self._stamps = log.unreadable, StampCheck(log)
        status_topic = STATUS.under(prefix).name
        self.found = Found(sensors, status_topic)
        self.found.account.numbering.recorded_before = log.published_before
        self._takers: dict[str, Callable[[Logged], None]] = {
            TRUTH.name: self._take_truth,
            ESTIMATE.under(prefix).name: self._take_estimate,
            status_topic: self._take_status,
            INTEGRITY.under(prefix).name: self._take_integrity,
            DIAGNOSTICS.name: self._take_diagnostics,
            FAULTS.name: self._take_faults,
            CLOCK.name: self._take_clock,
        }
        for sensor in sensors.values():
            self._takers[sensor.leading.name] = self._frame_taker(sensor.name)

    def take(self, logged: Logged) -> None:
        """Add a message of any topic."""
        self.found.account.take(logged)
        with self._unreadable.left_out(logged):
            self._stamps.peek(logged)
            self._takers.get(logged.topic, check_message)(logged)

    def _take_truth(self, logged: Logged) -> None:
        message = logged.decode()
        known = b""
        if message.pose.covariance.any():
            known = read_odometry(message).pose_covariance.tobytes()
        self.found.truth.add((read_stamp(message.header), pose_numbers(message.pose.pose), known))
        self._note_parent(message.header.frame_id, logged.topic)

    def _take_estimate(self, logged: Logged) -> None:
        message = logged.decode()
        read_odometry(message)
        pose, covariance = pose_numbers(message.pose.pose), message.pose.covariance.tobytes()
        publish_ns = min(logged.publish_ns, _LATEST_NS)
        self.found.estimates.add((read_stamp(message.header), pose, covariance, publish_ns))
        self._note_parent(message.header.frame_id, logged.topic)

    def _note_parent(self, frame_id: str, topic: str) -> None:
        if len(self.found.parents) < _MOST_PARENTS:
            self.found.parents.setdefault(shown(frame_id, _LONGEST), topic)

    def _take_status(self, logged: Logged) -> None:
        status = logged.decode()
        read = read_status(status)
        self.found.statuses.add(
            (
                read_stamp(status.header), self.found.statuses.count, status.mode, status.source,
                status.accepted, status.nis, status.processing_s, shown(status.sensor, _LONGEST),
                shown(status.reason, _LONGEST) or _lost(read.evidence), LOST_AFTER_S in read.evidence,
            )
        )  # fmt: skip

    def _take_integrity(self, logged: Logged) -> None:
        told = read_integrity(logged.decode())
        self.found.mounts |= mount_differences(told.evidence)
        self.found.integrity.add(
            (
                told.stamp_ns, int(told.state), told.attitude_level_deg, told.position_level_m,
                told.attitude_limit_deg, told.position_limit_m, shown(told.reason, _LONGEST),
            )
        )  # fmt: skip

    def _take_diagnostics(self, logged: Logged) -> None:
        for diagnostic in read_diagnostics(logged.decode()):
            self.found.account.take_diagnostic(diagnostic)

    def _take_faults(self, logged: Logged) -> None:
        for fault in read_faults(logged.decode()):
            if fault.identity in self.found.faults or len(self.found.faults) < _MOST_FAULTS:
                self.found.faults[fault.identity] = fault

    def _take_clock(self, logged: Logged) -> None:
        read_stamp(logged.decode())
        self.found.clock = True

    def _frame_taker(self, sensor: str) -> Callable[[Logged], None]:
        def take(logged: Logged) -> None:
            check_message(logged)
            self.found.frames.add((peek_stamp(logged.payload), sensor, min(logged.log_ns, _LATEST_NS)))

        return take


def _lost(evidence: Mapping[str, float]) -> str:
    """Return why a track was lost before an accepted frame that begins it again; empty if it was not."""
    if (after_s := evidence.get(LOST_AFTER_S)) is None:
        return ""
    return (
        f"the track was lost: no measurement was accepted for {after_s:.2f} s, and the covariance of the "
        "prediction was beyond the alert limit; this frame begins it again"
    )
