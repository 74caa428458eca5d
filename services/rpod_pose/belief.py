"""The belief in a measured pose: whether the measurement supports it, and why.

The method that measures a pose also states its belief in it. The navigator decides by this belief alone. A
``Record`` keeps the share of a sensor's recent frames that did not support the tracked pose.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform
from scipy.special import softmax

from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import BeliefLevel, Hypothesis

MEMORY_FRAMES, PRIOR_FRAMES = 90.0, 20.0
"""Number of frames that a record remembers, and number of consistent frames that it assumes at the beginning.
Hand: at 45 Hz a record remembers two seconds; the prior weighs less than half a second."""
MOST_SIGMA, MOST_SIGMA_DEG = 0.21, 10.0
"""Largest standard deviations with which a track begins at a predicted pose: of the position, over the radius
of the target, and of the attitude, deg. Hand: a track converges from there; with a larger value, tracks would
begin at poses that the frame does not determine."""
SYMMETRY = "symmetry of the target"
"""Name of a rival that is the best pose turned by an exact symmetry of the target."""
AMPLITUDE_LEFT_OUT = "amplitude_left_out"
"""Name of the evidence (1) that a camera's amplitude was left out: what is behind the target is bright and
has no range."""

NOISE_M, STATED_NOISE_M = "range_noise_m", "stated_range_noise_m"
"""Names of the evidence with the noise of its ranges that a scan shows, m, and with the one that is stated or
assumed; poses have the larger one."""


@dataclass(frozen=True)
class Angle:
    """Angle of a joint of the target."""

    angle_rad: float
    sigma_rad: float
    """Standard deviation of the angle. If the angle is unknown, it is that of a uniform distribution between
    the joint's limits."""


@dataclass(frozen=True, eq=False)
class Rival:
    """Another pose that explains a measurement about as well as the best one."""

    name: str
    """Difference from the best pose: ``SYMMETRY``, or "turned by 180 deg"."""
    T_sensor_target: RigidTransform
    log_likelihood: float
    """Log likelihood of the measurement at this pose minus that at the best one."""
    angles: Mapping[str, Angle] = field(default_factory=dict)
    """Angles of the target's joints at this pose, by name; they differ from those at the best one."""

    @property
    def exact(self) -> bool:
        """Whether no measurement can distinguish the rival from the best pose."""
        return self.name == SYMMETRY


@dataclass(frozen=True, eq=False)
class PixelMarks:
    """Pixels of a frame, or rays of a scan, that are inconsistent with a pose.

    The grid of these pixels may be coarser than that of the frame.
    """

    marked: NDArray[np.bool_]
    """Whether each pixel of the coarse grid is inconsistent, shape (rows, columns)."""
    stride: int
    """Distance between two neighbours in the coarse grid, in pixels of the frame."""

    @property
    def centre_px(self) -> tuple[int, int]:
        """Median column and median row of the marked pixels, in pixels of the frame."""
        row, column = (int(self.stride * (np.median(places) + 0.5)) for places in np.nonzero(self.marked))
        return column, row


@dataclass(frozen=True, eq=False)
class Belief:
    """A method's confidence in its own result."""

    level: BeliefLevel = BeliefLevel.ACCEPTED
    reason: str = ""
    """Reason why the result is not accepted, with figures, for the operator; empty if it is accepted."""
    evidence: Mapping[str, float] = field(default_factory=dict)
    """Numbers from which the level follows, by name. The name ends with the unit if the number has one."""
    rivals: tuple[Rival, ...] = ()
    """Other poses that explain the measurement, likeliest first. Those of an accepted pose are unlikely."""
    marks: PixelMarks | None = None
    """Pixels of the frame that are inconsistent with the pose; None if they are not known."""
    needed_weight: float = 1.0
    """Least weight at which the best pose is accepted. Its exact symmetries count as the pose itself."""
    insufficient: str = ""
    """Reason why the measurement alone cannot begin a track, although a running track may use it."""
    undetermined: str = ""
    """Part of the pose that the measurement alone leaves undetermined, as its covariance says: no track can
    begin, but what the measurement determines is as certain as that of any other."""

    @property
    def larger_noise_m(self) -> float:
        """Noise of its ranges with which a scan was registered, m; 0 if that is the stated or assumed one."""
        shown_m = self.evidence.get(NOISE_M, 0.0)
        return shown_m if shown_m > self.evidence.get(STATED_NOISE_M, 0.0) else 0.0

    @property
    def ranked(self) -> bool:
        """Whether the pose was compared with its rivals, which is possible for a contradicted pose too."""
        return self.needed_weight < 1.0

    @property
    def begins_track(self) -> bool:
        """Whether a track may begin at the pose: no likely rival is left that a measurement could exclude."""
        return self.continues_track and self._alone and not (self.insufficient or self.undetermined)

    @property
    def _alone(self) -> bool:
        """Whether no likely rival is left, or none that a measurement could exclude."""
        return self.level is BeliefLevel.ACCEPTED or all(rival.exact for rival in self.rivals)

    @property
    def refusal(self) -> str:
        """Reason why no track may begin at the pose."""
        return (self._alone and (self.insufficient or self.undetermined)) or self.reason

    @property
    def is_proof(self) -> bool:
        """Whether the measurement proves, without a prediction, what it determines of the pose."""
        return self.level is BeliefLevel.ACCEPTED and not self.insufficient

    @property
    def continues_track(self) -> bool:
        """Whether a running track may use the pose."""
        return self.level is not BeliefLevel.CONTRADICTED

    def hypotheses(self, T_sensor_target: RigidTransform) -> tuple[Hypothesis, ...]:
        """Return the pose and its rivals with weights proportional to their likelihoods, which sum to 1."""
        logs = np.array([0.0, *(rival.log_likelihood for rival in self.rivals)])
        poses = (("", T_sensor_target), *((rival.name, rival.T_sensor_target) for rival in self.rivals))
        return tuple(
            Hypothesis(pose=pose, weight=float(weight), name=name, log_likelihood=float(log))
            for (name, pose), weight, log in zip(poses, softmax(logs), logs, strict=True)
        )


def doubtful(reason: str, **evidence: float) -> Belief:
    """Return the belief in a result that the measurement supports too little."""
    return Belief(BeliefLevel.DOUBTFUL, reason, evidence)


def contradicted(reason: str, **evidence: float) -> Belief:
    """Return the belief in a result that is inconsistent with the measurement."""
    return Belief(BeliefLevel.CONTRADICTED, reason, evidence)


def undetermined(covariance: FloatArray, *, max_sigma_m: float, max_sigma_deg: float) -> str:
    """Return the reason why a measurement does not determine position or attitude; empty if it does.

    Args:
        covariance: covariance of (dp, dtheta), m and rad, shape (6, 6).
        max_sigma_m: largest allowed standard deviation of the position in its worst direction.
        max_sigma_deg: largest allowed standard deviation of the attitude about its worst axis.
    """
    for name, block, most, unit in (
        ("position", covariance[:3, :3], max_sigma_m, "m"),
        ("attitude", np.rad2deg(np.rad2deg(covariance[3:, 3:])), max_sigma_deg, "deg"),
    ):
        if not (sigma := worst_sigma(block)) <= most:
            figures = f"sigma {sigma:.2g} {unit}, limit {most:g} {unit}"
            return f"the {name} is undetermined: {figures}; wait for another side, or look from nearer"
    return ""


def worst_sigma(covariance: FloatArray) -> float:
    """Return the standard deviation in the worst direction of a covariance, (3, 3); NaN if it is unknown."""
    if not np.isfinite(covariance).all():
        return float("nan")
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))


@dataclass(frozen=True)
class Record:
    """Share of a sensor's frames that did not support the tracked pose; older frames count less.

    A single frame of another body may resemble the target by chance, or from one side. A stream of such
    frames does so only for a while.
    """

    frames: float = 0.0
    """Number of frames with a pose, where older frames count less."""
    unsupported: float = 0.0
    """Number of these frames whose belief was doubtful or contradicted."""

    @property
    def share(self) -> float:
        """Share of frames that did not support the pose."""
        return self.unsupported / (self.frames + PRIOR_FRAMES)

    def after(self, belief: Belief) -> "Record":
        """Return the record with one more frame that gave a pose."""
        kept = 1.0 - 1.0 / MEMORY_FRAMES
        against = belief.level is not BeliefLevel.ACCEPTED
        return Record(kept * self.frames + 1.0, kept * self.unsupported + against)
