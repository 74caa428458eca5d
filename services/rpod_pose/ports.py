"""The ports of the estimator: what a method must offer to take part.

A method is a value behind one of these protocols, chosen in the configuration. It sees one
measurement in its sensor's axes and the target's model, and neither bus, clock nor truth.
"""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.verification import VerificationConfig
from rpod_schemas.types import Hypothesis, LidarScan, PmdFrame, Source

MeasurementT_contra = TypeVar("MeasurementT_contra", LidarScan, PmdFrame, contravariant=True)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A pose that a search proposes."""

    T_sensor_target: RigidTransform
    cost_m2: float
    """The method's own cost, lower is better."""


@dataclass(frozen=True, eq=False)
class Registration:
    """A pose measured from one frame, or the reason why there is none."""

    source: Source
    T_sensor_target: RigidTransform | None = None
    reason: str = ""
    """Why there is no pose, or why it is not to be believed; empty otherwise."""
    cost_m2: float = float("nan")
    """f_CONV: mean squared residual of the inliers at convergence, m2."""
    inliers: int = 0
    inlier_share: float = float("nan")
    """Inliers over the points that could have matched."""
    explained_share: float = float("nan")
    """Self-check: of the rays where model or measurement say "surface", the share that agrees."""
    judged: bool = False
    """Whether the method has judged the pose by itself, so that its shares and cost are not asked."""
    contradicted: bool = False
    """Whether the frame speaks against the pose, rather than too little for it; it may yet be believed."""
    covariance: FloatArray = field(default_factory=lambda: np.full((6, 6), np.nan))
    """Of (dp, dtheta) in the sensor's fixed axes, dtheta = Log(R_est R^T) (ICD section 1); shape (6, 6)."""
    iterations: int = 0


class Verdict(StrEnum):
    """What an acquisition says of its own result."""

    ACCEPTED = "accepted"
    AMBIGUOUS = "ambiguous"
    """Several poses explain the measurement; the hypotheses list them."""
    FAILED = "failed"


@dataclass(frozen=True, eq=False)
class Acquisition:
    """What a search without a guess made of one measurement, checked and ranked."""

    verdict: Verdict
    registration: Registration
    """The best pose with its covariance, cost and self-check; without a pose where nothing was found."""
    reason: str = ""
    """Why it failed or what is ambiguous, in words for the operator; empty if accepted."""
    hypotheses: tuple[Hypothesis, ...] = ()
    """T_sensor_target of what explains the measurement, best first; weights sum to 1. Empty if failed."""
    templates: int = 0
    """Attitudes in the search."""
    excluded_share: float = 0.0
    """Of them, those left out before they were compared with the measurement."""
    by_symmetry: bool = False
    """Whether the hypotheses differ by exact symmetries of the target alone: any of them may be tracked."""

    @property
    def trackable(self) -> bool:
        """Whether a track may begin at the best pose."""
        return self.verdict is Verdict.ACCEPTED or self.by_symmetry

    @property
    def pose(self) -> RigidTransform | None:
        """T_sensor_target of the best pose; None where nothing was found."""
        return self.registration.T_sensor_target

    @property
    def covariance(self) -> FloatArray:
        """Of (dp, dtheta) in the sensor's fixed axes (ICD section 1), shape (6, 6)."""
        return self.registration.covariance


@dataclass(frozen=True, eq=False)
class Candidates:
    """What a search proposes, unchecked."""

    poses: tuple[Candidate, ...] = ()
    """Best first; empty where there is nothing to work on."""
    templates: int = 0
    """Attitudes in the search."""
    excluded_share: float = 0.0
    """Of them, those left out before they were compared with the measurement."""


class Search(Protocol, Generic[MeasurementT_contra]):
    """Proposes poses for one measurement, for a tracker to refine and check."""

    def search(self, measurement: MeasurementT_contra) -> Candidates:
        """Return candidates from everywhere. Deterministic."""
        ...

    def near(self, measurement: MeasurementT_contra, T_sensor_target: RigidTransform) -> Candidates:
        """Return candidates around a pose that is too far off for the tracker. Deterministic."""
        ...


class Acquirer(Protocol, Generic[MeasurementT_contra]):
    """Finds the target in one measurement and judges what it found."""

    def acquire(self, measurement: MeasurementT_contra) -> Acquisition:
        """Search without any prior pose; never raises on data. Deterministic."""
        ...

    def near(self, measurement: MeasurementT_contra, T_sensor_target: RigidTransform) -> Acquisition:
        """Search around a pose that is too far off for the tracker; never raises on data. Deterministic."""
        ...


class Tracker(Protocol, Generic[MeasurementT_contra]):
    """Registers one measurement, starting from a predicted pose."""

    def track(self, measurement: MeasurementT_contra, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration; never raises on data, says why instead. Deterministic."""
        ...


@dataclass(frozen=True, eq=False)
class Methods:
    """How one sensor's target is found and tracked, and when a registration is believed."""

    acquirer: Acquirer[Any]
    tracker: Tracker[Any]
    verification: VerificationConfig
