"""From the last iteration of a depth method to its registration: the checks, the cost, the covariance."""

from dataclasses import dataclass, field, replace
from typing import Protocol

from scipy.spatial.transform import RigidTransform

from rpod_pose.acceptance import accepted_by_residuals
from rpod_pose.belief import Belief, doubtful
from rpod_pose.pmd.depth_view import DepthImage
from rpod_pose.ports import Registration
from rpod_pose.registration.normal_equations import NormalEquations
from rpod_schemas.config.acceptance import AcceptanceConfig
from rpod_schemas.config.pmd_methods import DepthComparisonConfig, DepthErrorConfig
from rpod_schemas.types import Source
from rpod_target import Target


@dataclass(frozen=True, eq=False)
class Progress:
    """Where the iterations stand."""

    T_sensor_target: RigidTransform
    sums: NormalEquations = field(default_factory=NormalEquations.none)
    """Of the last iteration."""
    points: int = 0
    """Points that could have matched."""
    step_m: float = float("inf")
    """How far the last step moved the target's surface."""
    iterations: int = 0
    reason: str = ""
    """Why the iterations were given up; empty if they were not."""


class Conclusive(Protocol):
    """The parameters that every depth method has for its conclusion."""

    @property
    def unsettled_m(self) -> float:
        """A last step larger than this means that the iterations did not converge."""
        ...

    @property
    def comparison(self) -> DepthComparisonConfig:
        """The self-check."""
        ...

    @property
    def acceptance(self) -> AcceptanceConfig:
        """When the registration is believed."""
        ...

    @property
    def errors(self) -> DepthErrorConfig:
        """What the covariance assumes."""
        ...


def conclude(progress: Progress, image: DepthImage, target: Target, config: Conclusive) -> Registration:
    """Return the registration with its cost, covariance and self-check, or the reason why there is none."""
    sums, T = progress.sums, progress.T_sensor_target
    reason = progress.reason
    if not reason and progress.step_m > config.unsettled_m:
        reason = f"did not converge: the last of {progress.iterations} steps was {progress.step_m:.3f} m"
    if not reason and sums.degenerate(target.radius_m):
        reason = "degenerate: the matched surface leaves a motion undetermined"
    registration = Registration(
        Source.PMD_DEPTH,
        belief=doubtful(reason) if reason else Belief(),
        cost_m2=sums.cost_m2,
        inliers=sums.inliers,
        inlier_share=sums.inliers / progress.points if progress.points else 0.0,
        iterations=progress.iterations,
    )
    if reason:
        return registration
    registered = replace(
        registration,
        T_sensor_target=T,
        explained_share=image.compare(target, T, config.comparison).explained_share,
        covariance=sums.covariance(T, config.errors),
    )
    return accepted_by_residuals(registered, config.acceptance)
