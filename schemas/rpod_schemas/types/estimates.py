"""Results of the estimator beside the pose: its status, its belief, validity and integrity."""

from enum import IntEnum
from typing import Annotated

from pydantic import Field

from rpod_schemas.bounds import Text
from rpod_schemas.poses import Pose
from rpod_schemas.types.base import Model, Stamped


class Mode(IntEnum):
    """State of the navigator (EstimatorStatus.msg)."""

    ACQUIRING = 0
    VERIFYING = 1
    TRACKING = 2
    LOST = 3
    COASTING = 4
    """No measurement supports the track, and its prediction is within the alert limit."""

    @property
    def has_track(self) -> bool:
        """Whether the pose is published: by measurements, or predicted."""
        return self in (Mode.TRACKING, Mode.COASTING)


LOST_AFTER_S = "lost_after_s"
"""Name in the evidence of an accepted frame before which the track was lost, since its covariance was beyond
the alert limit: the time for which no measurement had been accepted."""


class Source(IntEnum):
    """Source of the measured pose (EstimatorStatus.msg)."""

    NONE = 0
    LIDAR = 1
    PMD_DEPTH = 2
    PMD_AMPLITUDE = 3
    PMD_JOINT = 4
    OTHER = 255
    """Source of another package's method; the status names the sensor."""


class BeliefLevel(IntEnum):
    """Level of belief in a measured pose (EstimatorStatus.msg)."""

    ACCEPTED = 0
    """The measurement supports the pose."""
    DOUBTFUL = 1
    """The measurement supports the pose weakly, or supports several poses equally."""
    CONTRADICTED = 2
    """The measurement is inconsistent with the pose."""


class Hypothesis(Model):
    """One of several poses that explain a measurement."""

    pose: Pose
    """T_chaser_target."""
    weight: Annotated[float, Field(ge=0, le=1)]
    """Probability, relative to the other hypotheses."""
    name: str = ""
    """Difference from the first: "symmetry of the target", "turned by 180 deg"; empty for the first."""
    log_likelihood: float = float("nan")
    """Log likelihood of the measurement at this pose minus that at the first one."""


class EstimatorStatus(Stamped):
    """Result of the estimator for one frame (EstimatorStatus.msg)."""

    mode: Mode
    """State of the navigator after the frame."""
    source: Source = Source.NONE
    """Method that measured the pose; NONE if there is no measured pose."""
    sensor: Text = ""
    """Name of the frame's sensor; empty for a prediction without a frame."""
    accepted: bool = False
    """Whether the measurement was accepted."""
    reason: Text = ""
    """Reason for which the measurement was rejected; empty if it was accepted."""
    cost_m2: float = float("nan")
    """Mean squared residual f_CONV, m2."""
    nis: float = float("nan")
    """Normalised innovation squared, six degrees of freedom, less those that a free axis takes away; NaN if
    the pose was not compared with a prediction."""
    inliers: Annotated[int, Field(ge=0)] = 0
    """Number of points that fit the model within their noise."""
    inlier_share: float = float("nan")
    """Number of inliers divided by the number of points that could have matched; NaN if unknown."""
    processing_s: float = float("nan")
    """Time from the arrival of the frame's last part to publication, s."""
    ambiguous: bool = False
    """Whether there are several hypotheses."""
    hypotheses: tuple[Hypothesis, ...] = ()
    """Hypotheses, best first; their weights sum to 1."""
    belief: BeliefLevel = BeliefLevel.ACCEPTED
    """Belief of the method in its pose, which the filter's gate may still reject."""
    evidence: dict[str, float] = Field(default_factory=dict)
    """Numbers from which the belief follows, by name; a name contains the unit if the number has one."""


class EstimateValidity(Stamped):
    """Whether the newest estimate may be used now (EstimateValidity.msg)."""

    valid: bool
    age_s: float
    """Age of the newest measurement that the estimate holds, s; NaN if there is none."""
    reason: Text
    """Reason why the estimate is not valid; empty if it is."""


class IntegrityState(IntEnum):
    """Whether the estimate may be used within its protection levels (Integrity.msg)."""

    UNAVAILABLE = 0
    """There is no estimate, or a protection level is above its alert limit."""
    NOMINAL = 1
    """All tests of the estimate pass, and both levels are below their alert limits."""
    CAUTION = 2
    """The same, but the newest measurement was not accepted, or a test is close to its limit."""
    ALERT = 3
    """A test failed: do not use the estimate, whatever its levels are."""

    @property
    def is_usable(self) -> bool:
        """Whether the estimate may be used within its levels."""
        return self in (IntegrityState.NOMINAL, IntegrityState.CAUTION)


class Integrity(Stamped):
    """Bounds of the errors that the estimate may have without an alert (Integrity.msg).

    The probability that an error exceeds its protection level without an alert is at most ``risk``.
    """

    state: IntegrityState
    reason: Text = ""
    """Reason for any state but nominal, with figures."""
    risk: Annotated[float, Field(gt=0, lt=1)]
    """Probability for each estimate that one of the errors is above its level without an alert."""
    attitude_level_deg: float = float("nan")
    """Protection level of the attitude, deg; NaN without an estimate."""
    position_level_m: float = float("nan")
    """Protection level of the position, m; NaN without an estimate."""
    attitude_limit_deg: float = float("nan")
    """Alert limit of the attitude, deg."""
    position_limit_m: float = float("nan")
    """Alert limit of the position at this range, m; NaN without an estimate."""
    evidence: dict[str, float] = Field(default_factory=dict)
    """Numbers from which state and levels follow, by name; a name contains the unit if the number has one."""
