"""State of the navigator between two steps, and the output of a step."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, auto

from scipy.spatial.transform import RigidTransform

from rpod_pose.belief import PixelMarks, Record
from rpod_pose.navigation.challenger import Challenger
from rpod_pose.navigation.filter import FilterState
from rpod_pose.navigation.first_pose.searches import AGE_S, SEARCHING, Search
from rpod_pose.navigation.history import History, Step
from rpod_pose.navigation.joints import JointTrack
from rpod_pose.navigation.rivals import Rivals
from rpod_pose.navigation.sensors.joining import Separation
from rpod_pose.navigation.sensors.streams import Stream, supported_ns
from rpod_pose.ports import Registration
from rpod_schemas.arrays import FloatArray
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.types import LOST_AFTER_S, EstimatorStatus, Joints, Mode, Odometry, Source


class Cause(Enum):
    """Kind of the reason for which a frame is not used, for code that decides by it."""

    OTHER = auto()
    OUT_OF_RANGE = auto()
    """The sensor is configured for other distances."""
    JOINING = auto()
    """The sensor joins the track as soon as other sensors confirm it."""
    SLOW_SEARCH = auto()
    """The frame came while a search for a first pose takes long."""


@dataclass(frozen=True, eq=False)
class GivenPose:
    """A pose from outside at which a track starts."""

    T_chaser_target: RigidTransform
    covariance: FloatArray
    """Covariance of (dp, dtheta), chaser axes, ICD section 1, shape (6, 6)."""
    stamp_ns: int | None = None
    """Stamp of the pose, ns of UTC; None for that of the first frame."""


@dataclass(frozen=True, eq=False)
class NavigatorState:
    """State of the navigator between two steps."""

    mode: Mode = Mode.ACQUIRING
    history: History | None = None
    """The filter's state and its recent past."""
    given: GivenPose | None = None
    """Pose at which the track starts with the next frame; None for none."""
    rivals: Rivals | None = None
    """Rivals of an ambiguous first pose while they are tracked in parallel."""
    streams: Mapping[str, Stream] = field(default_factory=dict)
    """Each sensor's frames, by its name."""
    established: frozenset[str] = frozenset()
    """Sensors that support the track on their own; empty while a given pose is not verified."""
    separation: Separation | None = None
    """The filters with and without the sensors that are not established; None if there are none."""
    lost_ns: int = 0
    """Stamp at which the target was lost."""
    before_loss: FilterState | None = None
    """Filter of the track that was lost, if only no frame supported it; None if frames contradicted it."""
    unseen_ns: int | None = None
    """Stamp of the last accepted frame before the newest time in which no frame showed the target where the
    track has it; None if there was none."""
    shown_ns: int = 0
    """Newest stamp of a published odometry; the stamps of the output never go back."""
    confirmations: int = 0
    """Number of consistent frames since the acquisition."""
    challenger: Challenger | None = None
    """Track of the believed poses that the gate has refused since the last accepted one."""
    joints: Mapping[str, JointTrack] = field(default_factory=dict)
    """Angles of the target's joints, by name; they are kept when a track ends."""
    records: Mapping[str, Record] = field(default_factory=dict)
    """Records of frames that did not support the tracked pose, by the sensor's name; they are kept when a
    track ends."""
    searches: Mapping[str, Search] = field(default_factory=dict)
    """Searches whose results are awaited, by the sensor's name."""

    def lost(self, stamp_ns: int, *, left: FilterState | None = None, seen: bool = False) -> "NavigatorState":
        """Return this state where the target is lost.

        Args:
            stamp_ns: stamp at which it is lost.
            left: filter of the track, if no frame has contradicted it.
            seen: whether believed poses show the target elsewhere.
        """
        unseen_ns = None if seen else supported_ns(self.streams)
        return replace(self, mode=Mode.LOST, lost_ns=stamp_ns, before_loss=left, unseen_ns=unseen_ns)

    def lost_s(self, stamp_ns: int) -> float:
        """Return the time for which the target has been lost at a stamp, s; 0 if it is not lost."""
        return (stamp_ns - self.lost_ns) / NANOSECONDS if self.mode == Mode.LOST else 0.0

    def recorded(self, sensor: str, registration: Registration) -> "NavigatorState":
        """Return this state after a registration, which is recorded if it gives a pose."""
        record = self.records.get(sensor, Record())
        if registration.T_sensor_target is not None:
            record = record.after(registration.belief)
        return replace(self, records={**self.records, sensor: record})

    def unsupported_share(self, sensor: str) -> float:
        """Return the share of a sensor's recent frames that did not support the tracked pose."""
        return self.records.get(sensor, Record()).share

    def acquiring(self) -> "NavigatorState":
        """Return this state without its pose, which was not verified."""
        return replace(self, mode=Mode.ACQUIRING, history=None, before_loss=None)

    def searching(self, search: Search) -> "NavigatorState":
        """Return this state while the result of a search is awaited."""
        return replace(self, searches={**self.searches, search.sensor: search})

    def waiting(self, sensor: str, stamp_ns: int) -> str:
        """Return the report that an earlier frame of a sensor is still being searched; empty if none is."""
        pending = self.searches.get(sensor)
        return "" if pending is None else SEARCHING.format(pending.age_s(stamp_ns))

    def verifies_another(self, sensor: str) -> bool:
        """Return whether another sensor's first pose is being verified, so that a search's result waits."""
        return self.mode == Mode.VERIFYING and bool(self.established - {sensor})

    def not_searching(self, sensor: str) -> "NavigatorState":
        """Return this state without the search of a sensor, if there is one."""
        left = {name: search for name, search in self.searches.items() if name != sensor}
        return replace(self, searches=left)


@dataclass(frozen=True, eq=False)
class RefusedPixels:
    """Pixels of a frame that contradict the pose at which it was compared with the target."""

    frame_id: str
    """Frame of the sensor."""
    marks: PixelMarks


@dataclass(frozen=True, eq=False)
class Output:
    """Output of a step."""

    status: EstimatorStatus
    odometry: Odometry | None
    refused: RefusedPixels | None = None
    """Pixels for which the frame was refused; None if it was not, or if they are not known."""
    joints: Joints | None = None
    """Angles of the target's joints, with the odometry; None for a target without joints."""
    weak_support: str = ""
    """Reason why a measurement that is used supports its pose only weakly; empty if it supports it well."""
    measured: Registration | None = None
    """Pose that was measured in the frame, unfiltered, sensor axes; None without a track, or if the pose was
    refused."""
    compared: Step | None = None
    """Comparison of a pose with the track that does not use it, of a sensor that is on probation, or that the
    gate refused; None for any other frame."""
    cause: Cause = Cause.OTHER
    """Kind of the status's reason, if there is one."""
    search: str = ""
    """Report about a search of the sensor's frames, the end of the status's reason; empty for none."""
    paused: bool = False
    """Whether the frame was not searched because the number of unsuccessful searches is limited."""
    lost: str = ""
    """Why the track was lost before an accepted frame that begins it again; empty if it was not."""
    unusable: str = ""
    """How the covariance of the odometry exceeds the alert limit; empty if it does not."""

    @property
    def why(self) -> str:
        """Reason of the status without the report about a search."""
        reason = self.status.reason
        return reason.removesuffix(self.search).removesuffix("; ") if self.search else reason

    def explained(self, why: str, cause: Cause) -> "Output":
        """Return this output with another reason, before the report about a search."""
        reason = "; ".join(filter(None, (why, self.search)))
        return replace(self, status=self.status.model_copy(update={"reason": reason}), cause=cause)

    def because(self, why: str) -> "Output":
        """Return this output with a reason before its own."""
        reason = f"{why}; {self.status.reason}"
        return replace(self, status=self.status.model_copy(update={"reason": reason}))

    def after_loss(self, why: str, unsupported_s: float) -> "Output":
        """Return this output of a frame before which the track was lost, with the reason.

        The status of an accepted frame has no reason. Instead, its evidence gives the time for which no frame
        was accepted.
        """
        if not self.status.accepted:
            return self.because(why) if self.status.mode == Mode.LOST else self
        text = f"the track was lost: {why}; this frame begins it again"
        return replace(self, lost=text).with_evidence(LOST_AFTER_S, unsupported_s)

    def with_evidence(self, name: str, value: float) -> "Output":
        """Return this output with one more number in the status's evidence."""
        return replace(
            self, status=self.status.model_copy(update={"evidence": {**self.status.evidence, name: value}})
        )

    def after_search(self, then: "Output", age_s: float) -> "Output":
        """Return this output of a frame at which the result of a search was applied.

        If neither frame is used, the search's reason and its cause come first.

        Args:
            then: the output of the search, at the stamp of the searched frame.
            age_s: time since that frame.
        """
        status, earlier = self.status, then.status
        if status.accepted or earlier.accepted:
            return self.with_evidence(AGE_S, age_s)
        text = f"{earlier.reason}, in the frame {age_s:.2f} s ago; {status.reason}"
        changes: dict[str, object] = {"reason": text}
        if status.source == Source.NONE:  # nothing was found in this frame itself
            kept = {"stamp_ns", "mode", "sensor", "frame_id"}
            evidence = {**earlier.evidence, **status.evidence}
            changes |= {name: getattr(status, name) for name in kept} | {"evidence": evidence}
            status = earlier
        both = replace(self, status=status.model_copy(update=changes), cause=then.cause)
        return both.with_evidence(AGE_S, age_s)
