"""The ports of the estimator: the interfaces that a method must implement.

A method implements one of these protocols and is chosen in the configuration. Its inputs are one measurement
in its sensor's axes and the target's model; it knows neither bus, clock nor truth.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Generic, Protocol, Self, TypeVar, runtime_checkable

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_pose.belief import Angle, Belief, doubtful
from rpod_pose.pose_evidence import ErrorParts, Misfit, OtherSize, PartSolution
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import BeliefLevel, Hypothesis, SensorFrame, Source
from rpod_target import Target

MeasurementT_contra = TypeVar("MeasurementT_contra", bound=SensorFrame, contravariant=True)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A pose that a search proposes."""

    T_sensor_target: RigidTransform
    cost_m2: float
    """Cost in the method's own measure; lower is better."""


@dataclass(frozen=True, eq=False)
class Registration:
    """A pose measured from one frame, or the reason why there is none."""

    source: Source
    T_sensor_target: RigidTransform | None = None
    """The measured pose; None if the frame gives none, with the reason in the belief."""
    belief: Belief = field(default_factory=Belief)
    """Belief in the pose; the navigator decides by it alone."""
    cost_m2: float = float("nan")
    """f_CONV: mean squared residual of the inliers at convergence, m2."""
    inliers: int = 0
    """Number of points that fit the model within their noise."""
    inlier_share: float = float("nan")
    """Number of inliers divided by the number of points that could have matched."""
    explained_share: float = float("nan")
    """Share of agreeing rays among those where model or measurement show a surface (the self-check)."""
    log_likelihood: float = float("nan")
    """Log likelihood of the frame at the pose, up to a constant that is the same for all poses and targets;
    NaN for a method without a likelihood."""
    covariance: FloatArray = field(default_factory=lambda: np.full((6, 6), np.nan))
    """Covariance of (dp, dtheta), sensor's fixed axes, dtheta = Log(R_est R^T) (ICD section 1), (6, 6). About
    a free axis of the target, the angle and its variance are arbitrary; the navigator replaces both."""
    parts: ErrorParts | None = None
    """Errors of the pose, separated by how long they last; None if the method does not separate them."""
    iterations: int = 0
    """Number of iterations of the method."""
    angles: Mapping[str, Angle] = field(default_factory=dict)
    """Angles of the target's joints, by name."""
    misfit: Misfit | None = None
    """Test of the target's model by the frame's residuals; None if the method has no such test."""
    range_bias_m: float = 0.0
    """Length by which all ranges of the frame are too long, estimated with the pose; 0 if the method does not
    estimate it."""
    other_sizes: Callable[[], tuple[OtherSize, ...]] = tuple
    """Function that returns poses for other sizes of the target; it returns none if the method does not
    compute them. They are computed at the call, so that the estimate does not wait for them."""
    by_part: PartSolution | None = None
    """Position measured by a part of the data; None if the method does not compute it."""

    @classmethod
    def none(cls, source: Source, reason: str, *, iterations: int = 0) -> "Registration":
        """Return the registration of a frame that gives no pose."""
        return cls(source, belief=doubtful(reason), iterations=iterations)

    @property
    def begins_track(self) -> bool:
        """Whether a track may begin at the pose."""
        return self.T_sensor_target is not None and self.belief.begins_track

    @property
    def continues_track(self) -> bool:
        """Whether a running track may use the pose."""
        return self.T_sensor_target is not None and self.belief.continues_track


class Outcome(StrEnum):
    """Outcome of a search."""

    ACCEPTED = "accepted"
    AMBIGUOUS = "ambiguous"
    """Several poses explain the measurement; the belief lists them as rivals."""
    FAILED = "failed"


@dataclass(frozen=True, eq=False)
class Acquisition:
    """Result of a search without a guess in one measurement."""

    registration: Registration
    """The best pose with its covariance and belief; without a pose if nothing was found."""
    templates: int = 0
    """Number of attitudes in the search."""
    excluded_share: float = 0.0
    """Share of these attitudes that were excluded before the comparison with the measurement."""

    @property
    def belief(self) -> Belief:
        """Belief in the best pose; its rivals are the other poses that explain the measurement."""
        return self.registration.belief

    @property
    def begins_track(self) -> bool:
        """Whether a track may begin at the best pose."""
        return self.registration.begins_track

    @property
    def pose(self) -> RigidTransform | None:
        """T_sensor_target of the best pose; None where nothing was found."""
        return self.registration.T_sensor_target

    @property
    def covariance(self) -> FloatArray:
        """Covariance of (dp, dtheta) in the sensor's fixed axes (ICD section 1), shape (6, 6)."""
        return self.registration.covariance

    @property
    def outcome(self) -> Outcome:
        """Outcome of the search, in one word."""
        if self.pose is None or not self.belief.continues_track:
            return Outcome.FAILED
        accepted = self.belief.level is BeliefLevel.ACCEPTED or not self.belief.rivals
        return Outcome.ACCEPTED if accepted else Outcome.AMBIGUOUS

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """Poses T_sensor_target that explain the measurement, best first; empty if the search failed."""
        if self.pose is None or self.outcome is Outcome.FAILED:
            return ()
        return self.belief.hypotheses(self.pose)


@dataclass(frozen=True, eq=False)
class Candidates:
    """Poses that a search proposes, not yet verified."""

    poses: tuple[Candidate, ...] = ()
    """Candidates, best first; empty if the measurement has too few points."""
    templates: int = 0
    """Number of attitudes in the search."""
    excluded_share: float = 0.0
    """Share of these attitudes that were excluded before the comparison with the measurement."""


class Search(Protocol, Generic[MeasurementT_contra]):
    """Proposes poses for one measurement, for a tracker to refine and check."""

    def search(self, measurement: MeasurementT_contra) -> Candidates:
        """Return candidates for the pose without any prior knowledge. Deterministic."""
        ...

    def near(self, measurement: MeasurementT_contra, T_sensor_target: RigidTransform) -> Candidates:
        """Return candidates near a pose that is too far off for the tracker. Deterministic."""
        ...


class Acquirer(Protocol, Generic[MeasurementT_contra]):
    """Finds the target in one measurement and verifies the pose."""

    def acquire(self, measurement: MeasurementT_contra) -> Acquisition:
        """Return the result of a search without a prior pose; never raises on data. Deterministic."""
        ...

    def near(self, measurement: MeasurementT_contra, T_sensor_target: RigidTransform) -> Acquisition:
        """Return the result of a search near a pose that is too far off for the tracker.

        Never raises on data. Deterministic.
        """
        ...


@runtime_checkable
class ComparingAcquirer(Acquirer[MeasurementT_contra], Protocol[MeasurementT_contra]):
    """An acquirer that also weighs poses against each other, so that rivals can be tracked."""

    def log_likelihoods(self, measurement: Any, found: Sequence[Registration], /) -> FloatArray:
        """Return the log likelihoods of one frame at registered poses: ``Likelihoods``."""
        ...


class Tracker(Protocol, Generic[MeasurementT_contra]):
    """Registers one measurement, starting from a predicted pose."""

    def track(self, measurement: MeasurementT_contra, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration, with a reason if there is no pose; never raises on data. Deterministic."""
        ...


@runtime_checkable
class ComparingTracker(Tracker[MeasurementT_contra], Protocol[MeasurementT_contra]):
    """A tracker that compares how well several poses explain a frame."""

    def log_likelihoods(
        self, measurement: MeasurementT_contra, found: Sequence[Registration], *, ranked_only: bool = False
    ) -> FloatArray:
        """Return the log likelihoods of one frame at poses registered in it, shape (N,), up to a constant.

        Args:
            measurement: the frame.
            found: the registrations.
            ranked_only: whether only the order of the values is needed, which takes less time to compute.
        """
        ...


@runtime_checkable
class WholeFrameTracker(Protocol):
    """A tracker that verifies poses in the whole frame after a search that used only a part of it."""

    def excluded(self, measurement: Any, T_sensor_target: RigidTransform) -> str:
        """Return why no pose near this one can be that of the target; empty if one can be."""
        ...

    def again(self, measurement: Any, found: Registration) -> Registration:
        """Return the frame's registration, started from the pose of an earlier one."""
        ...


@runtime_checkable
class ClimbingTracker(Protocol):
    """A tracker that spends more computation on a coarse first pose."""

    def climbed(self, measurement: Any, found: Registration) -> Registration:
        """Return a coarse registration at the likeliest pose nearby, or the registration itself."""
        ...


class Deskew(Protocol):
    """Moves points that were measured at other times to where they were at the frame's stamp."""

    def __call__(
        self,
        frame: Any,
        T_sensor_target: RigidTransform,
        /,
        *,
        velocity_m_s: FloatArray,
        rate_rad_s: FloatArray,
    ) -> Any:
        """Return the frame as if all of it had been measured at its stamp.

        Args:
            frame: frame as measured.
            T_sensor_target: predicted pose at the stamp.
            velocity_m_s: velocity of the target's origin, sensor axes, shape (3,).
            rate_rad_s: rate of the target relative to the sensor, sensor axes, shape (3,).
        """
        ...


class Likelihoods(Protocol):
    """Compares poses in one frame by the same log likelihood by which the search weighs its hypotheses."""

    def __call__(self, frame: Any, found: Sequence[Registration], /) -> FloatArray:
        """Return the log likelihoods of a frame at registered poses, shape (N,), up to a constant."""
        ...


@dataclass(frozen=True, eq=False)
class Methods:
    """The methods by which the target is found and tracked with one sensor."""

    acquirer: Acquirer[Any]
    tracker: Tracker[Any]
    deskew: Deskew | None = None
    """De-skewing, for a sensor whose frame is not measured all at once."""
    likelihoods: Likelihoods | None = None
    """Log likelihoods of poses; without them no rivals are tracked in the sensor's frames."""
    expecting: "Callable[[Mapping[str, Angle]], Methods] | None" = None
    """Function that returns the methods for expected angles of the target's joints, by name; None for a
    target without joints."""


@dataclass(frozen=True, eq=False)
class Task:
    """The data from which a method is made."""

    target: Target
    """The target to find and track."""
    sensor: Any
    """Configuration of the sensor, a ``rpod_schemas.config.sensor.SensorInput`` of its kind."""
    setup: Any = ()
    """Result of ``KindMethods.setup``."""
    tracker: Tracker[Any] | None = None
    """The sensor's tracker, by which an acquirer refines and checks its candidates."""

    def with_tracker(self, tracker: Tracker[Any]) -> Self:
        """Return this task with the tracker that the acquirer is to use."""
        return replace(self, tracker=tracker)


def _no_setup(_sensor: Any, _info: Any) -> Any:
    return ()


@dataclass(frozen=True, eq=False)
class KindMethods:
    """Functions that create and warm up the methods of a sensor kind."""

    make: Callable[[Task], Methods]
    """Function that returns the configured methods of a sensor."""
    frames: Callable[[Target, RigidTransform, Any], Sequence[Any]]
    """Function that returns frames without noise at T_sensor_target for a setup. Acquisition is warmed up
    with the first frame, tracking with all of them, so that compiled code is loaded before the first real
    frame."""
    setup: Callable[[Any, Any], Any] = _no_setup
    """Function that returns the data of a sensor that its methods need, from its configuration and its info
    message (None before the first message); None if neither contains them. When these data change, new
    methods are created."""
    masked: Callable[[Any, Callable[[Any], Any]], Any] | None = None
    """Function that removes points from a frame. It takes the frame and a second function, which gets the
    points, sensor axes, shape (..., 3), and returns true for those to remove. Without it, unreliable parts of
    a target are not ignored."""
    separation: Callable[[Any, Any], Any] | None = None
    """Function that returns the ``surroundings.frames.Frames`` of a sensor, from its configuration and
    setup. Without it, known surroundings are refused."""
    tracker: Callable[[Task], Tracker[Any]] | None = None
    """Function that returns the configured tracker alone, for a target whose joints move."""
    points: Callable[[Any], Any] | None = None
    """Function that returns the points of a frame, sensor axes, shape (N, 3). Without it or without
    ``tracker``, the parts of a target's joints are ignored like unreliable ones."""
    comparable: bool = False
    """Whether the log likelihoods of one frame may be compared between targets at different angles of their
    joints. If not, no rivals of a target with joints are tracked with this kind of sensor."""
    missing: str = ""
    """Reason for which frames are rejected as long as these data are unknown."""
