"""The ports of the estimator: what a method must offer to take part.

A method is a value behind one of these protocols, chosen in the configuration. It sees one
measurement in its sensor's axes and the target's model, and neither bus, clock nor truth.
"""

from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.verification import VerificationConfig
from rpod_schemas.types import LidarScan, PmdFrame, Source

MeasurementT_contra = TypeVar("MeasurementT_contra", LidarScan, PmdFrame, contravariant=True)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A pose that an acquisition proposes."""

    T_sensor_target: RigidTransform
    cost_m2: float
    """The method's own cost, lower is better."""


@dataclass(frozen=True, eq=False)
class Registration:
    """A pose measured from one frame, or the reason why there is none."""

    source: Source
    T_sensor_target: RigidTransform | None = None
    reason: str = ""
    """Why there is no pose; empty if there is one."""
    cost_m2: float = float("nan")
    """f_CONV: mean squared residual of the inliers at convergence, m2."""
    inliers: int = 0
    inlier_share: float = float("nan")
    """Inliers over the points that could have matched."""
    explained_share: float = float("nan")
    """Self-check: of the rays where model or measurement say "surface", the share that agrees."""
    covariance: FloatArray = field(default_factory=lambda: np.full((6, 6), np.nan))
    """Of (dp, dtheta) in the sensor's fixed axes, dtheta = Log(R_est R^T) (ICD section 1); shape (6, 6)."""
    iterations: int = 0


class Acquisition(Protocol, Generic[MeasurementT_contra]):
    """Finds the target in one measurement, without any prior pose."""

    def acquire(self, measurement: MeasurementT_contra) -> list[Candidate]:
        """Return candidates, best first; empty where there is nothing to work on. Deterministic."""
        ...

    def near(self, measurement: MeasurementT_contra, T_sensor_target: RigidTransform) -> list[Candidate]:
        """Return candidates, best first, around a pose that is too far off for the tracker. Deterministic."""
        ...


class Tracker(Protocol, Generic[MeasurementT_contra]):
    """Registers one measurement, starting from a predicted pose."""

    def track(self, measurement: MeasurementT_contra, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration; never raises on data, says why instead. Deterministic."""
        ...


@dataclass(frozen=True, eq=False)
class Methods:
    """One sensor's acquisition and tracker, and when their results are believed."""

    acquisition: Acquisition[Any]
    tracker: Tracker[Any]
    verification: VerificationConfig
